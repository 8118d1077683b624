"""From an experiment to its cells: everything that can be checked without computing is checked here."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

from evaluation.comparison.advice_cells import AdviseCell
from evaluation.comparison.champion_cells import RECOMMENDED, ChampionCell, EvolveCell
from evaluation.comparison.columns import Column, runner_of
from evaluation.comparison.condition_cells import ConditionsCell
from evaluation.comparison.controller_cells import ExploitCell, Matrix, RunCell
from evaluation.comparison.data_cells import GivenData, RecordedData, Split
from evaluation.comparison.experiment import BUDGETS, DEFAULT_ROBOT, Experiment
from evaluation.comparison.families import ALL, asked_models, ensembles_of, made, made_model, models_of
from evaluation.comparison.hand_written import HandWrittenCell, labels_inside
from evaluation.comparison.model_cells import FitCell, PredictCell, without_preset
from evaluation.comparison.named_files import files_beside
from evaluation.comparison.recipes import chosen_cell, controller_cell, evolution_on
from evaluation.prediction import PredictionProtocol, measured_cases
from evaluation.transfer import AT_REST, Measured, kept_traces
from evaluation.transfer.measured import FOLDER
from sysid_evo.arrays import Array
from sysid_evo.data import Dataset, check_usable
from sysid_evo.errors import (
    IncompatibleSystem,
    IncompatibleTask,
    InvalidArgument,
    InvalidData,
    UnknownName,
)
from sysid_evo.evolution import Champion, ControllerEvolution
from sysid_evo.evolution.feasibility import farthest_driven, farthest_recorded
from sysid_evo.plan import Again, Cell, Plan
from sysid_evo.registry import (
    Spec,
    aggregates,
    controllers,
    distinct,
    make_robot,
    robot_spec,
    robots,
    tasks,
)
from sysid_evo.system import System

AGAIN = "evaluation.comparison.again:plan_again"
"""What makes the plan of a comparison again in another process."""


@dataclass(frozen=True)
class Comparison:
    """An experiment with everything settled, and the cells of which it is made.

    ``experiment`` names all that was left open. Cells stand by the label of their model.
    """

    experiment: Experiment
    plan: Plan
    data: Cell
    fits: dict[str, FitCell]
    predictions: dict[str, PredictCell]
    advice: AdviseCell
    matrix: Matrix | None = None
    exploitability: ExploitCell | None = None
    conditions: Mapping[str, ConditionsCell] = field(default_factory=dict)

    @property
    def title(self) -> str:
        """What the report is called."""
        models = ", ".join(self.fits) if len(self.fits) <= 7 else f"{len(self.fits)} models"
        return self.experiment.title or f"{self.data.name}: {models}"


def plan_comparison(
    experiment: Experiment,
    *,
    dataset: Dataset | None = None,
    stored: tuple[Cell, System] | None = None,
    measured: Sequence[Measured] = (),
) -> Comparison:
    """Return the cells of ``experiment``; ``dataset`` holds its recordings, read already, if it has ``data``.

    ``stored`` is the cell of data that a run holds already, and their system; it stands for recordings and robot.

    Nothing is computed, and a robot is not connected to. Raises what is wrong with the experiment: names
    and parameters (`UnknownName`, `InvalidArgument`, `MissingExtra`), what does not fit together
    (`IncompatibleSystem`, `IncompatibleTask`, `InvalidArgument`), data that are of no use (`InvalidData`).
    """
    remarks: list[str] = []
    evolution = experiment.evolution
    _constructible(evolution)
    if experiment.by_hand and experiment.only is not None:
        raise InvalidArgument(f"by_hand: no controller is run with only = {experiment.only!r}; leave one out")
    robot = _robot(experiment, has_data=dataset is not None or stored is not None)
    if stored is not None:
        data, system = stored
    else:
        system = dataset.system if dataset is not None else _system_of(robot or robot_spec(DEFAULT_ROBOT))
        data = _data(experiment, robot, dataset)
    specs = models_of(experiment, system, remarks)
    labels = tuple(spec.label for spec in specs)
    ensembles = ensembles_of(experiment, labels)
    column = _robot_column(experiment, robot, system, remarks) if experiment.only is None else None
    if experiment.only is None:
        _check_control(evolution, system)
        farthest = _farthest(dataset, robot)
        if farthest is not None:
            remarks += evolution.make_task(system).doubts(farthest)
    fits = {spec.label: FitCell(spec, data, experiment.seed, experiment.preset) for spec in specs}
    several = _conditions(experiment, dataset)
    without = {label: ConditionsCell(fit, several) for label, fit in fits.items()} if several else {}
    predictions: dict[str, PredictCell] = {}
    if experiment.only != "fit":
        still = PredictCell.persistence(data)
        predictions = {
            still.label: still,
            **{label: PredictCell(label, fit.spec.name, data, fit) for label, fit in fits.items()},
        }
    settled = experiment.model_copy(
        update={
            **experiment.budget.model_dump(),
            "models": tuple(map(str, specs)),
            "ensembles": tuple("+".join(members) for members in ensembles),
            "robot": None if robot is None else experiment.robot or DEFAULT_ROBOT,
            "data_digest": data.digest,
        }
    )
    matrix, exploitability = None, None
    if experiment.only is None:
        columns = tuple(
            Column(label, fit.spec.name, model=fit, prediction=predictions.get(label)) for label, fit in fits.items()
        )
        matrix = _matrix(
            experiment,
            evolution,
            columns,
            column,
            ensembles,
            tuple(measured),
            _by_hand(experiment, evolution, system, fits, floor=column is not None),
            recorded=_is_recorded(data),
        )
        exploitability = ExploitCell(matrix, data, experiment.seed)
    advice = AdviseCell(data, fits, predictions, matrix, experiment.seed)
    wanted: list[Cell] = [data, *fits.values(), *predictions.values(), *without.values()]
    if matrix is not None and exploitability is not None:
        wanted += [*matrix.champions, *matrix.runs, exploitability]
    wanted.append(advice)
    again = Again(
        AGAIN,
        settled.model_dump(mode="json", exclude_none=True),
        after=(data.digest,),
        inside=(FOLDER.as_posix(),),
        files=files_beside(settled),
    )
    plan = Plan.of(wanted, remarks=remarks, again=again)
    return Comparison(settled, plan, data, fits, predictions, advice, matrix, exploitability, without)


def unsettled(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return stored settings without what their preset brought, so that another preset brings its own.

    Raises what the registry of models says about wrong names.
    """
    experiment = Experiment.of(settings)
    budget = BUDGETS[experiment.preset].model_dump()
    found = {name: value for name, value in settings.items() if name not in budget or value != budget[name]}
    if experiment.models is not None and experiment.models != (ALL,):
        specs = (without_preset(Spec.parse(text), experiment.preset) for text in experiment.models)
        found["models"] = tuple(map(str, specs))
    return found


def _constructible(evolution: ControllerEvolution) -> None:
    """Make what can be made without a system, so that wrong values are found now."""
    for registry, spec in ((tasks, evolution.task), (controllers, evolution.controller)):
        made(registry, spec)
    made(aggregates, Spec.parse(evolution.aggregate))


def _check_control(evolution: ControllerEvolution, system: System) -> None:
    """Raise what keeps task, controller and strategy from ``system``, and say what can be done without them."""
    try:
        task = evolution.make_task(system)
    except IncompatibleTask as error:
        raise IncompatibleTask(f"{error}. Name a task that fits (--task), or compare --only prediction") from error
    evolution.make_strategy(evolution.make_controller(task).n_parameters, 0)


def _farthest(dataset: Dataset | None, robot: Spec | None) -> Array | None:
    """Return how far the states go in the recordings, else on the emulated robot; None if neither can be known yet."""
    if dataset is not None:
        return farthest_recorded(dataset)
    return None if robot is None else _farthest_driven(robots.get(robot.name), str(robot))


@lru_cache(maxsize=64)
def _farthest_driven(_factory: Callable[..., Any], robot: str) -> Array | None:
    """Return how far the states go on ``robot``, once for all plans of a study; its factory tells namesakes apart."""
    dynamics = make_robot(robot_spec(robot)).dynamics
    return None if dynamics is None else farthest_driven(dynamics)


def _robot(experiment: Experiment, *, has_data: bool) -> Spec | None:
    if experiment.yardstick and experiment.only is not None:
        raise InvalidArgument(f"yardstick: no controller is evolved with only = {experiment.only!r}; leave one out")
    if experiment.robot is None:
        if experiment.yardstick and has_data:
            raise InvalidArgument("yardstick: name the emulated robot that it is evolved on with --robot")
        return None if has_data else robot_spec(DEFAULT_ROBOT)
    return robot_spec(experiment.robot)


def _system_of(robot: Spec) -> System:
    system: System = make_robot(robot).system
    return system


def _robot_column(experiment: Experiment, robot: Spec | None, system: System, remarks: list[str]) -> Column | None:
    """Return the column of the emulated robot; a physical one gets its column when it is driven."""
    if robot is None:
        return None
    machine = make_robot(robot)
    differences = system.differences(machine.system)
    if differences:
        raise IncompatibleSystem(
            f"robot {robot.label!r} is not the one in the recordings: {'; '.join(differences)}. "
            "Leave --robot out, or name the robot that was recorded"
        )
    if not machine.physical:
        return Column(robot.label, robot.label, robot=robot)
    if experiment.yardstick:
        runner_of(robot)
    remarks.append(f"{robot.label} is a physical robot: its column is filled by sysid-evo drive --controller")
    return None


def check_experiment(experiment: Experiment) -> None:
    """Raise what is wrong with the names and parameters of ``experiment``: all that needs no data to be read."""
    _constructible(experiment.evolution)
    robot = _robot(experiment, has_data=experiment.data is not None)
    if robot is not None:
        make_robot(robot)
    asked = asked_models(experiment)
    if asked is not None:
        for spec in asked:
            made_model(spec, experiment.preset)
        ensembles_of(experiment, tuple(spec.label for spec in asked))


def _data(experiment: Experiment, robot: Spec | None, dataset: Dataset | None) -> Cell:
    share = 0.0 if experiment.only == "fit" and experiment.test is None else experiment.held_back
    split = Split(experiment.test, share)
    if dataset is None:
        if experiment.test is not None:
            raise InvalidArgument("test: a robot that is recorded has no named episodes yet; give --data for that")
        if share == 0.0 and experiment.only != "fit":
            raise InvalidArgument("held_back: expected a share above 0, so that models can be tested")
        recorded = robot or robot_spec(DEFAULT_ROBOT)
        make_robot(recorded).check()
        return RecordedData(recorded, experiment.seed, experiment.minutes, split)
    if share == 0.0 and experiment.test is None and experiment.only != "fit":
        raise InvalidArgument("held_back: expected a share above 0, so that models can be tested")
    parts = split.of(dataset)
    check_usable(parts.training, name="the training data")
    if parts.test is not None and experiment.only != "fit":
        _check_predictable(parts.training, parts.test)
    return GivenData(dataset, split)


def _conditions(experiment: Experiment, dataset: Dataset | None) -> int:
    """Return how many conditions are left out in turn, 0 for none. Raises `InvalidArgument` if there is only one."""
    if experiment.leave_out is None:
        return 0
    if experiment.only == "fit":
        raise InvalidArgument("leave_out: nothing is tested with only = 'fit'; leave one out")
    found = () if dataset is None else dataset.conditions
    if len(found) < 2:
        raise InvalidArgument(
            "leave_out: expected recordings of two or more conditions, got "
            f"{len(found)}: name them with sysid-evo import --condition NAME=PATTERN, and give the data set with --data"
        )
    return len(found)


def _is_recorded(data: Cell) -> bool:
    """Whether the data are recorded here on a robot, or were when the run was made."""
    return isinstance(data, RecordedData) or "robot" in data.inputs()


def _check_predictable(training: Dataset, test: Dataset) -> None:
    """Raise `InvalidData` if there is nothing in ``test`` that a model could be asked to predict."""
    cases = measured_cases(training, test, PredictionProtocol())
    if not cases.horizons:
        raise InvalidData(
            f"test: no model can be measured on the part held back: {cases.notes[0]}. "
            "Record more, or name a longer episode with --test"
        )


def _by_hand(
    experiment: Experiment,
    evolution: ControllerEvolution,
    system: System,
    fits: Mapping[str, FitCell],
    *,
    floor: bool,
) -> tuple[HandWrittenCell, ...]:
    """Return the cells of controllers that need no evolution. Raises why one cannot be made, or cannot do the task.

    Whether one can do the task with a model that is still to be fitted inside is found when it is made. Where fitness
    may be negative and there is a robot, its ``floor``, controls at rest are among them: shares are measured from it.
    """
    specs = distinct(tuple(Spec.parse(text) for text in experiment.by_hand))
    if floor and evolution.make_task(system).worst < 0.0 and all(spec.name != AT_REST for spec in specs):
        specs = (*specs, Spec.parse(f"rest={AT_REST}"))
    cells = []
    for spec in specs:
        controllers.check(spec)
        inside = {label: fits[label] for label in labels_inside(spec, fits)}
        if inside:
            made(controllers, spec)
        else:
            try:
                Champion.hand_written(spec, evolution.task, system)
            except UnknownName as error:
                raise UnknownName(f"by_hand: {spec}: {error}; the models compared are {', '.join(fits)}") from error
        cells.append(HandWrittenCell(spec, evolution.task, system, inside))
    return tuple(cells)


def _matrix(
    experiment: Experiment,
    evolution: ControllerEvolution,
    models: tuple[Column, ...],
    robot: Column | None,
    ensembles: tuple[tuple[str, ...], ...],
    measured: tuple[Measured, ...],
    by_hand: tuple[HandWrittenCell, ...],
    *,
    recorded: bool,
) -> Matrix:
    by_label = {column.label: column for column in models}
    columns = models if robot is None else (*models, robot)
    groups: list[tuple[Column, ...]] = [(column,) for column in models]
    groups += [tuple(by_label[member] for member in members) for members in ensembles]
    quick = robot is not None and robot.robot is not None and make_robot(robot.robot).dynamics is not None
    usual = quick and recorded and experiment.budget.recipe == "recommended"
    if robot is not None and (usual if experiment.yardstick is None else experiment.yardstick):
        groups.append((robot,))
    evolved = tuple(EvolveCell(members, evolution_on(experiment, members), experiment.seed) for members in groups)
    champions: tuple[ChampionCell | HandWrittenCell, ...] = evolved
    if experiment.budget.recipe == "recommended":
        champions = tuple(chosen_cell(experiment, (cell,), models) for cell in evolved)
        if len(models) > 1:
            several = tuple(cell for cell in evolved if len(cell.members) > 1)
            champions += (
                controller_cell(experiment, models, judges=models, label=RECOMMENDED, sift=True, further=several),
            )
    champions += by_hand
    names = [champion.name for champion in champions]
    taken = [cell.name for cell in by_hand if names.count(cell.name) > 1]
    if taken:
        raise InvalidArgument(
            f"by_hand: another controller is called {taken[0]!r}; give a label of its own, label=NAME"
        )
    runs = tuple(
        RunCell(
            champion,
            column,
            delay=evolution.estimator_delay,
            trials=experiment.transfer_trials,
            traces=kept_traces(experiment.traces, own=column == robot or any(map(column.is_same, champion.members))),
            seed=experiment.seed,
        )
        for champion in champions
        for column in columns
    )
    return Matrix(champions, columns, runs, None if robot is None else robot.label, measured)
