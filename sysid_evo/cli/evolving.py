"""`sysid-evo evolve`: a controller against a chosen ensemble of models."""

from __future__ import annotations

import json as json_format
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sysid_evo.cli.console import out, session, tell
from sysid_evo.cli.exits import SOME_FAILED
from sysid_evo.cli.options import (
    Aggregate,
    Caution,
    Controller,
    DryRun,
    EstimatorDelay,
    Generations,
    Jobs,
    Json,
    Noise,
    Plugins,
    Preset,
    Recipe,
    Runs,
    Schedule,
    Seed,
    Strategy,
    Task,
    Trials,
    given,
    latest_run_folder,
    load_plugins,
    seconds,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from evaluation.comparison import Column, Experiment, RunCell
    from evaluation.comparison.champion_cells import ChampionCell
    from sysid_evo.dynamics import Dynamics
    from sysid_evo.evolution import ControllerEvolution
    from sysid_evo.plan import Again, Plan, Record, Store
    from sysid_evo.system import System

CLAIM_TRIALS = 100
AGAIN = "sysid_evo.cli.evolving:plan_again"
"""What makes the plan of a command again in another process."""


def evolve(
    against: Annotated[str, typer.Option(help="Fitted models or robots, separated by commas.")],
    aggregate: Aggregate = None,
    noise: Noise = None,
    caution: Caution = None,
    task: Task = None,
    controller: Controller = None,
    strategy: Strategy = None,
    recipe: Recipe = None,
    run: Annotated[Path | None, typer.Option(help="Run folder with the models (default: the newest).")] = None,
    preset: Preset = "standard",
    generations: Generations = None,
    trials: Trials = None,
    runs: Runs = None,
    estimator_delay: EstimatorDelay = None,
    schedule: Schedule = None,
    seed: Seed = None,
    plugin: Plugins = None,
    jobs: Jobs = None,
    dry_run: DryRun = False,
    json: Json = False,
) -> None:
    """Evolve a controller against one model or against an ensemble of them at once.

    A model is named as it was when it was fitted in the run folder, by the path of its file, or by the
    name of an emulated robot. Against robots and files alone, the controller is stored in a new run
    folder unless --run names one. For a real robot give the delay that `sysid-evo robots check` tells,
    so that controllers meet it in the models.
    """
    from evaluation.comparison import Experiment, check_run_folder
    from sysid_evo.cli.comparing import print_plan
    from sysid_evo.cli.expecting import forecast_from, forecast_sentence
    from sysid_evo.cli.progress import Bars
    from sysid_evo.cli.unrecorded import print_regions, regions_of
    from sysid_evo.plan import Again, Store, execute

    load_plugins(plugin)
    settings = given(
        aggregate=aggregate,
        noise=noise,
        caution=caution,
        task=task,
        controller=controller,
        strategy=strategy,
        recipe=recipe,
        schedule=schedule,
        preset=preset,
        generations=generations,
        trials=trials,
        runs=runs,
        estimator_delay=seconds(estimator_delay),
        seed=seed,
        plugins=None if plugin is None else tuple(str(path.resolve()) for path in plugin),
    )
    experiment = Experiment.of(settings)
    members = split_members(against)
    alone = run is None and not any(is_model_of_a_run(member) for member in members)
    store = Store(check_run_folder(None) if alone else latest_run_folder(run))
    columns = tuple(find_column(store, member) for member in members)
    evolution = experiment.evolution
    for doubt in check_evolution(store, columns, evolution):
        tell(doubt, label="note: ", style="dim")
    champion, claims, elsewhere = cells_of(experiment, store, columns)
    plan = plan_of(champion, claims, elsewhere, again=Again(AGAIN, {"settings": settings, "members": members}))
    if dry_run:
        print_plan(plan, store, json=json)
        return
    session.run = store.path
    with Bars(f"--run {store.path}") as bars:
        outcomes = execute(plan, store, observer=bars, jobs=jobs)
    failed = [cell for cell in plan if outcomes[cell.digest].failed]
    file = f"{store.where(champion)}.json"
    found: dict[str, Any] = {"controller": champion.name, "file": file, "claims": {}}
    if champion not in failed:
        unit = ""
        for cell in claims:
            value = store.outcome(cell).value
            if value is not None:
                unit = value.unit
                found["claims"][cell.column.label] = {"mean": value.mean, "std": value.std, "trials": value.trials}
        on_models = all(column.robot is None for column in columns)
        runs_there = (*claims, *elsewhere) if on_models else ()
        expected = forecast_from(store, store.outcome(champion).value, runs_there)
        found["forecast"] = None if expected is None else asdict(expected)
        models = {column.label: dynamics_of(store, column) for column in columns if has_dynamics(column)}
        regions = regions_of(store.outcome(champion).value, models)
        if json:
            unrecorded = [region.sentence for region in regions]
            out.print_json(json_format.dumps({**found, "unit": unit, "record_next": unrecorded}))
        else:
            for label, claim in found["claims"].items():
                spread = f"{claim['mean']:.1f} ± {claim['std']:.1f} {unit} in {claim['trials']} fresh trials"
                out.print(f"{label}: {spread}", highlight=False, markup=False)
            if expected is not None:
                chosen = chosen_from(champion, store)
                out.print(forecast_sentence(expected, unit, chosen=chosen), highlight=False, markup=False)
            print_regions(champion.name, regions)
            out.print(f"stored as {file}", highlight=False, markup=False, soft_wrap=True)
    if failed:
        raise typer.Exit(SOME_FAILED)


def cells_of(
    experiment: Experiment, store: Store, columns: tuple[Column, ...]
) -> tuple[ChampionCell, tuple[RunCell, ...], tuple[RunCell, ...]]:
    """Return the cell of the controller against ``columns``, those of its claims there, and on the run's other models.

    What is evolved on a robot is run nowhere else: there is nothing to forecast.
    """
    from evaluation.comparison import RunCell, controller_cell
    from sysid_evo.cli.expecting import by_label

    others = other_models(store, columns)
    champion = controller_cell(experiment, columns, judges=columns + others)
    delay = experiment.evolution.estimator_delay

    def on(column: Column) -> RunCell:
        return RunCell(champion, column, delay, CLAIM_TRIALS, 0, experiment.seed)

    labels = {column.label for column in columns}
    models = [] if any(column.robot is not None for column in columns) else by_label(others)
    return champion, tuple(map(on, columns)), tuple(on(column) for column in models if column.label not in labels)


def plan_of(
    champion: ChampionCell, claims: Sequence[RunCell], elsewhere: Sequence[RunCell], again: Again | None = None
) -> Plan:
    """Return the plan of a controller, its claims, and what its forecast is made of where it is run elsewhere."""
    from sysid_evo.plan import Plan

    judged = (*claims, *elsewhere) if len(claims) + len(elsewhere) > 1 else ()
    predictions = [run.column.prediction for run in judged if run.column.prediction is not None]
    return Plan.of([champion, *claims, *elsewhere, *predictions], again=again)


def chosen_from(champion: ChampionCell, store: Store) -> int:
    """Return from how many finalists a controller was chosen by their forecasts, 0 where it was not."""
    from evaluation.comparison.champion_cells import ChooseCell, PolishCell

    choice = champion.chosen if isinstance(champion, PolishCell) else champion
    if not isinstance(choice, ChooseCell):
        return 0
    return sum(one.elsewhere is not None for one in store.outcome(choice).value.finalists)


def plan_again(made_of: Mapping[str, Any], run: Path) -> Plan:
    """Return the plan of the same command again, for another process."""
    from evaluation.comparison import Experiment
    from sysid_evo.plan import Store

    experiment = Experiment.of(made_of["settings"])
    load_plugins([Path(plugin) for plugin in experiment.plugins])
    store = Store(run)
    return plan_of(*cells_of(experiment, store, tuple(find_column(store, member) for member in made_of["members"])))


def split_members(text: str) -> tuple[str, ...]:
    """Split ``a,b,c`` at the commas outside brackets. Raises `InvalidArgument`."""
    from sysid_evo.cli.options import listed
    from sysid_evo.errors import InvalidArgument

    members = listed("--against", text) or ()
    repeated = sorted({member for member in members if members.count(member) > 1})
    if repeated:
        raise InvalidArgument(f"--against: {', '.join(repeated)} is named twice")
    return members


def check_evolution(store: Store, columns: tuple[Column, ...], evolution: ControllerEvolution) -> tuple[str, ...]:
    """Check that all members have one system, and that task and controller fit it. Raises what does not.

    Returns why the task cannot be done well by the first of them whose equations are known, in sentences.
    """
    from sysid_evo.errors import IncompatibleSystem
    from sysid_evo.evolution.feasibility import farthest_driven

    systems = {column.label: system_of(store, column) for column in columns}
    (first, system), *others = systems.items()
    for label, other in others:
        differences = system.differences(other)
        if differences:
            raise IncompatibleSystem(f"--against: {first} and {label} have different systems: {'; '.join(differences)}")
    task = evolution.make_task(system)
    evolution.stages(task, tuple(systems))
    evolution.make_strategy(evolution.make_controller(task).n_parameters, 0)
    known = next((column for column in columns if has_dynamics(column)), None)
    farthest = None if known is None else farthest_driven(dynamics_of(store, known))
    return () if farthest is None else task.doubts(farthest)


def other_models(store: Store, columns: tuple[Column, ...]) -> tuple[Column, ...]:
    """Return the models of the run that are of one system with ``columns`` and not among them."""
    system = system_of(store, columns[0])
    taken = {column.model.digest for column in columns if column.model is not None}
    found = []
    for record in store.records():
        if record.kind == "fit" and record.status == "done" and record.digest not in taken:
            column = column_of(store, record)
            if not system.differences(dynamics_of(store, column).system):
                found.append(column)
    return tuple(found)


def is_file(name: str) -> bool:
    """Whether ``name`` is the path of a stored model."""
    from sysid_evo.store import is_stored

    return is_stored(name, "model")


def is_robot(name: str) -> bool:
    """Whether ``name`` is a spec of a registered robot, or a file that describes one."""
    from sysid_evo.errors import InvalidArgument
    from sysid_evo.registry import robot_spec, robots

    if name.endswith(".toml"):
        return True
    try:
        return robot_spec(name).name in robots.names()
    except InvalidArgument:
        return False


def is_model_of_a_run(name: str) -> bool:
    """Whether ``name`` can only be a model in a run folder."""
    return not is_file(name) and not is_robot(name)


def find_column(store: Store, name: str) -> Column:
    """Return the model or emulated robot that ``name`` stands for. Raises `InvalidArgument`, `ArtefactError`."""
    from evaluation.comparison import Column, StoredModel, runner_of
    from sysid_evo.registry import robot_spec
    from sysid_evo.store import stored_file

    if is_file(name):
        file = stored_file(name, "model")
        own = record_of_file(store, file)
        if own is not None:
            return column_of(store, own)
        model = StoredModel(file)
        return Column(model.name, model.family, model=model)
    if is_robot(name):
        spec = robot_spec(name)
        runner_of(spec)
        return Column(spec.label, spec.label, robot=spec)
    return column_of(store, find_model(store, name))


def column_of(store: Store, record: Record) -> Column:
    """Return the model of a run as a column, with the cell of how well it predicts what was held back of its data."""
    from evaluation.comparison import Column, FitCell, GivenData, PredictCell
    from sysid_evo.plan import StoredCell

    model, family = StoredCell(record, FitCell), record.inputs["model"]["name"]
    data = next((one for one in store.records() if one.digest in record.needs and one.status == "done"), None)
    if data is None or not (data.inputs["split"]["test"] or data.inputs["split"]["share"]):
        return Column(record.name, family, model=model)
    prediction = PredictCell(record.name, family, StoredCell(data, GivenData), model)
    return Column(record.name, family, model=model, prediction=prediction)


def record_of_file(store: Store, file: Path) -> Record | None:
    """Return the record of the run's model that stands in ``file``, None if it is no model of the run."""
    stem = file.with_suffix("").resolve()
    for record in store.records():
        if record.kind == "fit" and record.status == "done" and (store.path / record.artefact).resolve() == stem:
            return record
    return None


def find_model(store: Store, name: str) -> Record:
    """Return the record of the model called ``name`` in a run. Raises `InvalidArgument` that names those there are."""
    from sysid_evo.errors import InvalidArgument

    stored = [record for record in store.records() if record.kind == "fit" and record.status == "done"]
    files = {Path(record.artefact).name: record for record in stored}
    if name in files:
        return files[name]
    fitting = [record for record in stored if record.name == name]
    if len(fitting) == 1:
        return fitting[0]
    if fitting:
        several = ", ".join(Path(record.artefact).name for record in fitting)
        raise InvalidArgument(f"{name!r} stands for several models of {store.path}: {several}; name one of these")
    known = ", ".join(dict.fromkeys(record.name for record in stored)) or "none"
    raise InvalidArgument(f"{name!r} is not among the models of {store.path}: {known}")


def has_dynamics(column: Column) -> bool:
    """Whether the equations behind a column can be stepped: a model's and an emulated robot's, no environment's."""
    from sysid_evo.registry import make_robot

    return column.robot is None or make_robot(column.robot).dynamics is not None


def system_of(store: Store, column: Column) -> System:
    """Return the system of the model or robot behind a column."""
    from sysid_evo.registry import make_robot

    if column.robot is None:
        return dynamics_of(store, column).system
    system: System = make_robot(column.robot).system
    return system


def dynamics_of(store: Store, column: Column) -> Dynamics:
    """Return the model or the emulated robot behind a column."""
    from evaluation.comparison import StoredModel, emulated

    if column.robot is not None:
        return emulated(column.robot)
    assert column.model is not None
    model: Dynamics = (
        column.model.load(column.model.path) if isinstance(column.model, StoredModel) else store.load(column.model)
    )
    return model
