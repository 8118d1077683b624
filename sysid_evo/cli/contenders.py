"""Which stored controllers and systems the words on a command line stand for, and whether they fit each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from evaluation.comparison import Column
    from sysid_evo.engine import Runner
    from sysid_evo.evolution import Champion
    from sysid_evo.plan import Record, Store
    from sysid_evo.system import System

KINDS = ("by_hand", "evolve", "choose", "polish")
"""Kinds of cells whose result is a controller; of the same name the later kind counts."""


@dataclass(frozen=True)
class Place:
    """A system to run controllers on: its label in the matrix, and the run folder whose models it is one of."""

    label: str
    column: Column
    store: Store

    @property
    def system(self) -> System:
        from sysid_evo.cli.columns import system_of

        return system_of(self.store, self.column)

    @property
    def runner(self) -> Runner:
        """How controllers are run there. Raises `InvalidArgument` for a physical robot."""
        from evaluation.comparison import runner_of
        from sysid_evo.cli.columns import dynamics_of
        from sysid_evo.engine import DynamicsRunner

        if self.column.robot is not None:
            return runner_of(self.column.robot)
        return DynamicsRunner(dynamics_of(self.store, self.column))


@dataclass(frozen=True)
class Contender:
    """A controller, and the run folder that it comes from; None if it comes from none."""

    champion: Champion
    run: Path | None = None


def places(names: Sequence[str], run: Path | None) -> tuple[Place, ...]:
    """Return the systems that ``names`` stand for: run folders, files of models, robots, models of ``run``.

    A run folder stands for all its models. Raises `InvalidArgument` for what there is not.
    """
    from evaluation.comparison import is_run
    from sysid_evo.cli.columns import column_of, find_column, is_model_of_a_run
    from sysid_evo.cli.options import latest_run_folder
    from sysid_evo.errors import InvalidArgument
    from sysid_evo.plan import Store

    found: list[Place] = []
    for name in names:
        if Path(name).is_dir() and is_run(Path(name)):
            store = Store(Path(name))
            fitted = [one for one in store.records() if one.kind == "fit" and one.status == "done"]
            if not fitted:
                raise InvalidArgument(f"--on: the run {name} holds no fitted model")
            found += [Place(one.name, column_of(store, one), store) for one in fitted]
        else:
            store = Store(latest_run_folder(run) if is_model_of_a_run(name) else run or Path())
            column = find_column(store, name)
            found.append(Place(column.label, column, store))
    labels = _told_apart([(place.label, place.store.path.name) for place in found])
    return tuple(replace(place, label=label) for place, label in zip(found, labels, strict=True))


def contenders(names: Sequence[str], system: System, task: str | None) -> tuple[Contender, ...]:
    """Return the controllers that ``names`` stand for: run folders, files, specs of those written by hand.

    A run folder stands for all its controllers. With ``task`` all of them do that one, else each the one it was made
    for, and one written by hand that of the first. Raises `InvalidArgument` if these differ.
    """
    from evaluation.comparison import is_run
    from sysid_evo.cli.achieving import is_stored, owner_of
    from sysid_evo.errors import InvalidArgument
    from sysid_evo.evolution import Champion
    from sysid_evo.registry import Spec
    from sysid_evo.store import load_champion

    found: list[Contender] = []
    written: list[str] = []
    for name in names:
        if Path(name).is_dir() and is_run(Path(name)):
            found += [Contender(champion, Path(name)) for champion in _of_run(Path(name))]
        elif is_stored(name):
            found.append(Contender(load_champion(name), owner_of(Path(name))))
        else:
            written.append(name)
    if task is not None:
        found = [replace(one, champion=replace(one.champion, task=Spec.parse(task))) for one in found]
    goal = found[0].champion.task if found else Spec.parse(task or "point_to_point")
    found += [Contender(Champion.hand_written(name, goal, system)) for name in written]
    others = [one.champion for one in found if one.champion.task != goal]
    if others:
        raise InvalidArgument(
            f"{found[0].champion.name} does {goal}, {others[0].name} does {others[0].task}: what they score cannot be "
            "compared. Name one task for all with --task"
        )
    labels = _told_apart([(one.champion.name, one.run.name if one.run else "") for one in found])
    return tuple(
        replace(one, champion=replace(one.champion, name=label)) for one, label in zip(found, labels, strict=True)
    )


def check_fit(controllers: Sequence[Contender], systems: Sequence[Place]) -> None:
    """Raise for the first controller that does not fit: `IncompatibleSystem`, `IncompatibleTask`, `InvalidArgument`."""
    from sysid_evo.errors import IncompatibleSystem, InvalidArgument
    from sysid_evo.evolution import observed_late
    from sysid_evo.registry import make_controller, make_task

    for place in systems:
        system, runner = place.system, place.runner
        for one in controllers:
            champion = one.champion
            try:
                champion.check_system(system)
            except IncompatibleSystem as error:
                raise IncompatibleSystem(f"{champion.name} cannot be run on {place.label}: {error}") from error
            observed_late(place.label, runner, champion.estimator_delay)
            law = make_controller(champion.controller).bind_to(make_task(champion.task).bind(system))
            if law.n_parameters != len(champion.parameters):
                raise InvalidArgument(
                    f"{champion.name} cannot do {champion.task}: there it needs {law.n_parameters} parameters and it "
                    f"has {len(champion.parameters)}, as it was evolved with other observations"
                )


def with_models(one: Contender, systems: Sequence[Place]) -> tuple[Champion, dict[str, str]]:
    """Return the controller with what it was evolved against named as in ``systems``, and the families of the rest.

    A model is the same if its content is; those that are not among ``systems`` keep their name behind that of the run.
    """
    from sysid_evo.cli.columns import find_model
    from sysid_evo.errors import InvalidArgument
    from sysid_evo.plan import Store

    against, families = [], {}
    robots = {place.column.label: place.label for place in systems if place.column.robot is not None}
    digests = {place.column.model.digest: place.label for place in systems if place.column.model is not None}
    for label in one.champion.against:
        record: Record | None = None
        if one.run is not None and label not in robots:
            try:
                record = find_model(Store(one.run), label)
            except InvalidArgument:  # a robot, or a model that was removed since
                record = None
        name = robots.get(label) if record is None else digests.get(record.digest)
        if name is None:
            name = f"{one.run.name if one.run else 'elsewhere'}/{label}"
            families[name] = label if record is None else str(record.inputs["model"]["name"])
        against.append(name)
    return replace(one.champion, against=tuple(against)), families


def _of_run(run: Path) -> list[Champion]:
    """Return the controllers of a run: the rows of its matrix, and of what was evolved since what nothing needs."""
    from evaluation.comparison import FILE, EvolveCell
    from sysid_evo.cli.reporting import comparison_of
    from sysid_evo.errors import InvalidArgument
    from sysid_evo.plan import Store, StoredCell

    store = Store(run)
    matrix = comparison_of(run)[0].matrix if (run / FILE).is_file() else None
    rows = [] if matrix is None else [cell for cell in matrix.champions if store.done(cell)]
    made: list[Any] = [record for record in store.records() if record.kind in KINDS and record.status == "done"]
    needed = {digest for record in made for digest in record.needs} | {cell.digest for cell in rows}
    others = [record for record in made if record.digest not in needed]
    found = [store.load(cell) for cell in rows]
    found += [store.load(StoredCell(record, EvolveCell)) for record in sorted(others, key=_rank)]
    if not found:
        raise InvalidArgument(f"the run {run} holds no controller: evolve one first")
    return found


def _rank(record: Record) -> int:
    return KINDS.index(record.kind)


def _told_apart(names: Sequence[tuple[str, str]]) -> list[str]:
    """Return each name alone if no other is like it, else behind its run, and numbered where that does not help."""
    plain = [name for name, _ in names]
    found = [name if plain.count(name) == 1 or not run else f"{run}/{name}" for name, run in names]
    return [name if found.count(name) == 1 else f"{name}#{found[:i].count(name) + 1}" for i, name in enumerate(found)]
