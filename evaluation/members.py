"""Resolves names to models, robots, controllers, files and run folders, and checks that they fit each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from evaluation.cells.models import Predict, StoredModelCell
from evaluation.cells.plants import Plant, emulated, runner_of
from evaluation.experiment import FILE, default_task
from evaluation.planning import comparison_of
from evaluation.run_folder import is_run, latest_run_folder, run_of_controller, stored_settings
from evaluation.transfer.matrix import TransferMatrix, transfer_seeds, try_controller
from sysid_evo.artefacts import is_stored_artefact, stored_file
from sysid_evo.controllers.controller import make_controller
from sysid_evo.engine import DynamicsRunner, Runner
from sysid_evo.errors import IncompatibleSystem, InvalidArgument
from sysid_evo.evolution import Champion, ControllerEvolution, delayed_runner
from sysid_evo.evolution.champion import load_champion
from sysid_evo.evolution.controller_evolution import simulated_state_range
from sysid_evo.models import Dynamics, load_model
from sysid_evo.plan import Cell, CellRecord, Store, stored
from sysid_evo.progress import Progress
from sysid_evo.registry import Spec, make_robot, robot_spec, robots
from sysid_evo.system import System
from sysid_evo.tasks.task import make_task

CONTROLLER_KINDS = ("baseline", "evolve", "select", "polish")
"""Kinds of cells whose result is a controller; of two with the same name the later kind counts."""


@dataclass(frozen=True)
class TransferTarget:
    """A system to run controllers on: its label in the matrix, and the run folder that it belongs to."""

    label: str
    column: Plant
    store: Store

    @property
    def system(self) -> System:
        return system_of(self.store, self.column)

    @property
    def runner(self) -> Runner:
        """Return the runner of controllers there. Raises `InvalidArgument` for a physical robot."""
        if self.column.robot is not None:
            return runner_of(self.column.robot)
        return DynamicsRunner(dynamics_of(self.store, self.column))


@dataclass(frozen=True)
class StoredController:
    """A controller, and the run folder that it comes from; None if it comes from none."""

    champion: Champion
    run: Path | None = None


def transfer_targets(names: Sequence[str], run: Path | None) -> tuple[TransferTarget, ...]:
    """Return the systems named by ``names``: run folders, files of models, robots, models of ``run``.

    A run folder means all its models. Raises `InvalidArgument` for unknown names.
    """
    found: list[TransferTarget] = []
    for name in names:
        if Path(name).is_dir() and is_run(Path(name)):
            store = Store(Path(name))
            fitted = fitted_models(store)
            if not fitted:
                raise InvalidArgument(f"--on: the run {name} contains no fitted model")
            found += [TransferTarget(one.name, column_of(store, one), store) for one in fitted]
        else:
            store = Store(latest_run_folder(run) if is_model_of_a_run(name) else run or Path())
            column = find_column(store, name)
            found.append(TransferTarget(column.label, column, store))
    labels = _unique_names([(place.label, place.store.path.name) for place in found])
    return tuple(replace(place, label=label) for place, label in zip(found, labels, strict=True))


def stored_controllers(
    names: Sequence[str], system: System, task: str | None, *, robots: Sequence[Spec | None] = ()
) -> tuple[StoredController, ...]:
    """Return the controllers named by ``names``: run folders, files, specs of baseline controllers.

    A run folder gives all its controllers. All perform ``task``; without one, each performs the task that it was
    evolved for, and a baseline controller that of the first, else that of the first of ``robots``. Raises
    `InvalidArgument` if these tasks differ.
    """
    found: list[StoredController] = []
    written: list[str] = []
    for name in names:
        if Path(name).is_dir() and is_run(Path(name)):
            found += [StoredController(champion, Path(name)) for champion in _of_run(Path(name))]
        elif is_stored_artefact(name, "controller"):
            found.append(StoredController(load_champion(name), run_of_controller(Path(name))))
        else:
            written.append(name)
    if task is not None:
        found = [replace(one, champion=replace(one.champion, task=Spec.parse(task))) for one in found]
    goal = found[0].champion.task if found else Spec.parse(task or default_task(robots))
    found += [StoredController(Champion.baseline(name, goal, system)) for name in written]
    others = [one.champion for one in found if one.champion.task.shown != goal.shown]  # each has learned its own reward
    if others:
        raise InvalidArgument(
            f"{found[0].champion.name} does {goal.shown}, {others[0].name} does {others[0].task.shown}: their scores "
            "cannot be compared. Name one task for all with --task"
        )
    labels = _unique_names([(one.champion.name, one.run.name if one.run else "") for one in found])
    return tuple(
        replace(one, champion=replace(one.champion, name=label)) for one, label in zip(found, labels, strict=True)
    )


def check_fit(controllers: Sequence[StoredController], systems: Sequence[TransferTarget]) -> None:
    """Raise for the first controller that does not fit: `IncompatibleSystem`, `IncompatibleTask`, `InvalidArgument`."""
    for place in systems:
        system, runner = place.system, place.runner
        for one in controllers:
            champion = one.champion
            try:
                champion.check_system(system)
            except IncompatibleSystem as error:
                raise IncompatibleSystem(f"{champion.name} cannot be run on {place.label}: {error}") from error
            delayed_runner(place.label, runner, champion.estimator_delay)
            law = make_controller(champion.controller).bind_to(make_task(champion.task).bind(system))
            if law.n_parameters != len(champion.parameters):
                raise InvalidArgument(
                    f"{champion.name} cannot do {champion.task.shown}: it needs {law.n_parameters} parameters there, "
                    f"and has {len(champion.parameters)}, because it was evolved with other observations"
                )


def with_models(one: StoredController, systems: Sequence[TransferTarget]) -> tuple[Champion, dict[str, str]]:
    """Return the controller with its members named as in ``systems``, and the families of those not among them.

    Models are compared by content; those that are not among ``systems`` get the name of their run as a prefix.
    """
    against, families = [], {}
    robots = {place.column.label: place.label for place in systems if place.column.robot is not None}
    digests = {place.column.model.digest: place.label for place in systems if place.column.model is not None}
    for label in one.champion.against:
        record: CellRecord | None = None
        if one.run is not None and label not in robots:
            try:
                record = find_model(Store(one.run), label)
            except InvalidArgument:  # a robot, or a model that has been removed
                record = None
        name = robots.get(label) if record is None else digests.get(record.digest)
        if name is None:
            name = f"{one.run.name if one.run else 'elsewhere'}/{label}"
            families[name] = label if record is None else str(record.inputs["model"]["name"])
        against.append(name)
    return replace(one.champion, against=tuple(against)), families


def _of_run(run: Path) -> list[Champion]:
    """Return the controllers of a run: the rows of its matrix, and later ones that no other cell needs."""
    store = Store(run)
    matrix = comparison_of(run)[0].matrix if (run / FILE).is_file() else None
    rows = [] if matrix is None else [cell for cell in matrix.controllers if store.done(cell)]
    made: list[Any] = [
        record for record in store.records() if record.kind in CONTROLLER_KINDS and record.status == "done"
    ]
    needed = {digest for record in made for digest in record.needs} | {cell.digest for cell in rows}
    others = [record for record in made if record.digest not in needed]
    found = [store.load(cell) for cell in rows]
    others.sort(key=lambda record: CONTROLLER_KINDS.index(record.kind))
    found += [store.load(stored(record)) for record in others]
    if not found:
        raise InvalidArgument(f"the run {run} contains no controller: evolve one first")
    return found


def _unique_names(names: Sequence[tuple[str, str]]) -> list[str]:
    """Return unique names: a repeated one gets the name of its run as a prefix, and a number if that is not enough."""
    plain = [name for name, _ in names]
    found = [name if plain.count(name) == 1 or not run else f"{run}/{name}" for name, run in names]
    return [name if found.count(name) == 1 else f"{name}#{found[:i].count(name) + 1}" for i, name in enumerate(found)]


def check_evolution(store: Store, columns: tuple[Plant, ...], evolution: ControllerEvolution) -> tuple[str, ...]:
    """Check that all members have one system, and that task and controller fit it. Raises the errors of these checks.

    Returns sentences on limits of the task for the first member whose equations are known.
    """
    systems = {column.label: system_of(store, column) for column in columns}
    (first, system), *others = systems.items()
    for label, other in others:
        differences = system.differences(other)
        if differences:
            raise IncompatibleSystem(f"--against: {first} and {label} have different systems: {'; '.join(differences)}")
    task = evolution.make_task(system)
    evolution.make_strategy(evolution.make_controller(task).n_parameters, 0)
    known = next((column for column in columns if has_dynamics(column)), None)
    farthest = None if known is None else simulated_state_range(dynamics_of(store, known))
    return () if farthest is None else task.feasibility_warnings(farthest)


def other_models(store: Store, columns: tuple[Plant, ...]) -> tuple[Plant, ...]:
    """Return the models of the run that have the system of ``columns`` and are not among them."""
    system = system_of(store, columns[0])
    taken = {column.model.digest for column in columns if column.model is not None}
    others = [column_of(store, record) for record in fitted_models(store) if record.digest not in taken]
    return tuple(column for column in others if not system.differences(system_of(store, column)))


def fitted_models(store: Store) -> list[CellRecord]:
    """Return the records of the models of a run, the oldest first."""
    return [record for record in store.records() if record.kind == "fit" and record.status == "done"]


def is_robot(name: str) -> bool:
    """Whether ``name`` is a spec of a registered robot, or a file that describes one."""
    if name.endswith(".toml"):
        return True
    try:
        return robot_spec(name).name in robots.names()
    except InvalidArgument:
        return False


def is_model_of_a_run(name: str) -> bool:
    """Whether ``name`` can only be a model in a run folder."""
    return not is_stored_artefact(name, "model") and not is_robot(name)


def find_column(store: Store, name: str) -> Plant:
    """Return the model or emulated robot called ``name``. Raises `InvalidArgument`, `ArtefactError`."""
    if is_stored_artefact(name, "model"):
        file = stored_file(name, "model")
        stem = file.with_suffix("").resolve()
        own = next((one for one in fitted_models(store) if (store.path / one.artefact).resolve() == stem), None)
        if own is not None:
            return column_of(store, own)
        model = StoredModelCell(file).cell()
        return Plant(model.name, model.settings.family, model)
    if is_robot(name):
        spec = robot_spec(name)
        runner_of(spec)
        return Plant(spec.label, spec.label, robot=spec)
    return column_of(store, find_model(store, name))


def column_of(store: Store, record: CellRecord) -> Plant:
    """Return the model of a run as a column, with the cell of its prediction error on held-out data."""
    model, family = stored(record), record.inputs["model"]["name"]
    times = stored_settings(store.path).get("step_seconds", {})
    slow = next((seconds for text, seconds in times.items() if Spec.parse(text).label == record.name), 0.0)
    data = data_of(store, record)
    if data is None or not any(data.settings.inputs()["split"].values()):
        return Plant(record.name, family, model=model, slow=slow)
    prediction = Predict(record.name, family, data, model).cell()
    return Plant(record.name, family, model=model, prediction=prediction, slow=slow)


def data_of(store: Store, model: CellRecord) -> Cell | None:
    """Return the cell of the data that a model of a run was fitted to, None if they are not in the run."""
    found = (store.find(digest) for digest in model.needs)
    return next((stored(one) for one in found if one is not None and one.status == "done"), None)


def find_model(store: Store, name: str) -> CellRecord:
    """Return the record of the model called ``name`` in a run. Raises `InvalidArgument` that lists the known ones."""
    models = fitted_models(store)
    files = {Path(record.artefact).name: record for record in models}
    if name in files:
        return files[name]
    fitting = [record for record in models if record.name == name]
    if len(fitting) == 1:
        return fitting[0]
    if fitting:
        several = ", ".join(Path(record.artefact).name for record in fitting)
        raise InvalidArgument(f"{name!r} names several models of {store.path}: {several}; name one of these")
    known = ", ".join(dict.fromkeys(record.name for record in models)) or "none"
    raise InvalidArgument(f"{name!r} is not among the models of {store.path}: {known}")


def has_dynamics(column: Plant) -> bool:
    """Whether the equations of a column can be stepped: those of models and emulated robots, not of environments."""
    return column.robot is None or make_robot(column.robot).dynamics is not None


def system_of(store: Store, column: Plant) -> System:
    """Return the system of the model or robot behind a column."""
    if column.robot is None:
        return dynamics_of(store, column).system
    system: System = make_robot(column.robot).system
    return system


def dynamics_of(store: Store, column: Plant) -> Dynamics:
    """Return the model or the emulated robot behind a column."""
    if column.robot is not None:
        return emulated(column.robot)
    assert column.model is not None
    settings = column.model.settings
    model: Dynamics = load_model(settings.path) if isinstance(settings, StoredModelCell) else store.load(column.model)
    return model


TRACES = 10
"""Number of trials of each cell whose trajectories are kept, for the behaviour of controllers."""


def matrix_of(
    drivers: Sequence[StoredController],
    systems: Sequence[TransferTarget],
    *,
    seed: int,
    trials: int,
    progress: Progress | None = None,
) -> TransferMatrix:
    """Run every controller on every system in the same fresh trials."""
    families = {place.label: place.column.registered for place in systems}
    champions = []
    for one in drivers:
        champion, elsewhere = with_models(one, systems)
        champions.append(champion)
        families |= elsewhere
    robots = [place.label for place in systems if place.column.robot is not None]
    seeds, cells = transfer_seeds(seed, trials), []
    runners = {place.label: place.runner for place in systems}
    for champion in champions:
        for label, runner in runners.items():
            late = delayed_runner(label, runner, champion.estimator_delay)
            cells.append(try_controller(champion, label, late, seeds, traces=TRACES))
            if progress is not None:
                progress(len(cells), len(champions) * len(systems))
    return TransferMatrix.of(
        champions,
        tuple(runners),
        cells,
        families=families,
        robot=robots[-1] if robots else None,
        other_robots=robots[:-1],
    )
