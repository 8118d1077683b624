"""Makes the cells of an experiment, with every check that needs no computing; the same plan from a run folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

from evaluation.cells.assessment import Advise, AssessExploitability, PlannedMatrix, Run
from evaluation.cells.controllers import (
    POLISHED,
    Baseline,
    ControllerCell,
    Evolve,
    chosen_cell,
    controller_cell,
    evolution_on,
    evolution_settings,
    labels_inside,
    with_starts,
)
from evaluation.cells.data import GivenData, HoldOut, RecordedData
from evaluation.cells.learned_task import LearnTask, learning_cell, needed
from evaluation.cells.models import Fit, LeaveConditionsOut, Predict, ScoreFit
from evaluation.cells.plants import SLOW, Plant, runner_of, steps_in
from evaluation.cells.rounds import ChooseRound, Round, RoundData, default_rounds, last_round, trials_end_early
from evaluation.cells.slow_models import slow_remarks, times_of_steps
from evaluation.chosen_models import (
    ALL,
    ensembles_of,
    made,
    made_model,
    models_of,
    requested_models,
    scoring_models_of,
    searched_of,
    without_preset,
)
from evaluation.experiment import BUDGETS, DEFAULT_ROBOT, FILE, Experiment, check_settings, with_rounds, with_task
from evaluation.prediction.cases import PredictionProtocol, measured_cases
from evaluation.prediction.scores import PERSISTENCE
from evaluation.rounds import ROUNDS
from evaluation.transfer.matrix import AT_RANDOM, AT_REST, MeasuredResult, kept_traces, load_measured
from sysid_evo.controllers.controller import make_controller
from sysid_evo.data import Dataset, check_usable
from sysid_evo.errors import (
    ArtefactError,
    IncompatibleSystem,
    IncompatibleTask,
    InvalidArgument,
    InvalidData,
    UnknownName,
)
from sysid_evo.evolution import Champion, ControllerEvolution
from sysid_evo.evolution.aggregates import make_aggregate
from sysid_evo.evolution.controller_evolution import recorded_state_range, simulated_state_range
from sysid_evo.plan import Cell, Plan, Store, stored
from sysid_evo.registry import (
    Spec,
    check_labels,
    controllers,
    load_named_plugins,
    make_robot,
    robot_spec,
    robots,
    tasks,
)
from sysid_evo.system import System
from sysid_evo.types import Array


@dataclass(frozen=True)
class Comparison:
    """An experiment with all settings resolved, and its cells.

    ``experiment`` names everything that was left open. Cells are keyed by the label of their model.
    """

    experiment: Experiment
    plan: Plan
    data: Cell
    fits: dict[str, Cell[Fit]]
    predictions: dict[str, Cell[Predict]]
    advice: Cell[Advise]
    matrix: PlannedMatrix | None = None
    exploitability: Cell[AssessExploitability] | None = None
    conditions: Mapping[str, Cell[LeaveConditionsOut]] = field(default_factory=dict)
    held_out_scores: Mapping[str, Cell[ScoreFit]] = field(default_factory=dict)
    learned: Cell[LearnTask] | None = None
    last_round: Cell[Round] | None = None

    @property
    def title(self) -> str:
        """Title of the report."""
        models = ", ".join(self.fits) if len(self.fits) <= 7 else f"{len(self.fits)} models"
        return self.experiment.title or f"{self.data.name}: {models}"


def plan_comparison(
    experiment: Experiment,
    *,
    dataset: Dataset | None = None,
    held: tuple[Cell, System] | None = None,
    measured: Sequence[MeasuredResult] = (),
) -> Comparison:
    """Return the cells of ``experiment``; ``dataset`` are its recordings, already read, if it has ``data``.

    ``held`` is the cell of data that a run already has, and their system; it replaces recordings and robot.
    Nothing is computed, and no robot is connected. Raises errors in the experiment: names and parameters
    (`UnknownName`, `InvalidArgument`, `MissingExtra`), parts that do not fit together (`IncompatibleSystem`,
    `IncompatibleTask`, `InvalidArgument`), unusable data (`InvalidData`).
    """
    remarks: list[str] = []
    check_settings(experiment, has_data=dataset is not None or held is not None)
    robot = _robot(experiment, has_data=dataset is not None or held is not None)
    if held is None:
        system = dataset.system if dataset is not None else make_robot(robot or robot_spec(DEFAULT_ROBOT)).system
    else:
        system = held[1]
    if experiment.rounds is None and robot is not None and dataset is None and held is None:
        experiment = experiment.model_copy(update={"rounds": default_rounds(experiment, robot)})
    in_rounds = experiment.stop_after is None and (experiment.rounds or 1) > 1
    if in_rounds:
        early = robot is not None and dataset is None and held is None and trials_end_early(experiment, robot)
        experiment = with_rounds(experiment, system, early=early)
    if experiment.stop_after is None:
        experiment = with_starts(with_task(experiment, (robot,)), system, robot)
    evolution = evolution_settings(experiment)
    _constructible(evolution)
    first = data = held[0] if held is not None else _data(experiment, robot, dataset, whole=in_rounds)
    specs = models_of(experiment, system, remarks)
    if scoring := scoring_models_of(experiment, system):
        if experiment.searched is None:
            experiment = experiment.model_copy(update={"searched": tuple(spec.label for spec in specs)})
        specs = (*specs, *scoring)
    searched = searched_of(experiment, tuple(spec.label for spec in specs))
    slow = _slow(experiment, specs, system, dataset, held is not None)
    ensembles = ensembles_of(experiment, searched)
    last = None
    if in_rounds:
        inside = tuple(spec for spec in specs if spec.label in searched)
        last = last_round(experiment, _robot_column(experiment, robot, system, []), first, inside)
        data = RoundData(last, HoldOut(experiment.test, experiment.held_out)).cell()
    fits = {spec.label: Fit(spec, data, experiment.seed, experiment.preset).cell() for spec in specs}
    predictions: dict[str, Cell[Predict]] = {}
    if experiment.stop_after != "fit":
        if PERSISTENCE in fits:
            raise InvalidArgument(_taken(PERSISTENCE, "the prediction of no change"))
        predictions[PERSISTENCE] = Predict(PERSISTENCE, PERSISTENCE, data).cell()
        for label, fit in fits.items():
            predictions[label] = Predict(label, fit.settings.spec.name, data, fit).cell()
    matrix, exploitability, learned = None, None, None
    if experiment.stop_after is None:
        column = _robot_column(experiment, robot, system, remarks)
        _check_control(evolution, system)
        learned = learning_cell(evolution.task, experiment.search_minutes, data, dataset)
        farthest = _farthest(dataset, robot)
        if farthest is not None:
            remarks += evolution.make_task(system).feasibility_warnings(farthest)
        # recorded here, or when the run was made
        recorded = "robot" in data.settings.inputs()
        reference = has_reference(experiment, column, remarks, recorded=recorded)
        plants = tuple(
            Plant(
                label,
                fit.settings.spec.name,
                fit,
                prediction=predictions[label],
                slow=slow.get(str(fit.settings.spec), 0.0),
            )
            for label, fit in fits.items()
        )
        remarks += slow_remarks(experiment, plants)
        matrix = _matrix(
            experiment,
            evolution,
            plants,
            column,
            searched,
            ensembles,
            tuple(measured),
            _baselines(experiment, evolution, system, fits, learned),
            learned,
            last,
            remarks,
            reference=reference,
        )
        if column is not None and column.timed:  # not decided again elsewhere
            trials = next(run.settings.trials for run in matrix.runs if run.settings.column == column)
            experiment = experiment.model_copy(update={"reference": reference, "robot_trials": trials})
        exploitability = AssessExploitability(matrix, data).cell()
    held_out_scores = (
        {label: ScoreFit(fit).cell() for label, fit in fits.items()} if experiment.stop_after == "fit" else {}
    )
    several = _conditions(experiment, dataset)
    without = {label: LeaveConditionsOut(fit, several).cell() for label, fit in fits.items()} if several else {}
    settled = experiment.model_copy(
        update={
            **experiment.budget.model_dump(),
            "models": tuple(map(str, specs)),
            "ensembles": tuple("+".join(members) for members in ensembles),
            "robot": None if robot is None else experiment.robot or DEFAULT_ROBOT,
            "step_seconds": slow,
            "data_digest": first.digest,
        }
    )
    advice = Advise(data, fits, predictions, matrix, experiment.seed, held_out_scores).cell()
    wanted: list[Cell] = [data, *fits.values(), *predictions.values(), *without.values(), *held_out_scores.values()]
    wanted += needed(learned)
    if matrix is not None and exploitability is not None:
        wanted += [*matrix.controllers, *matrix.runs, exploitability]
    wanted.append(advice)
    plan = Plan.of(wanted, remarks=remarks)
    return Comparison(
        settled,
        plan,
        data,
        fits,
        predictions,
        advice,
        matrix,
        exploitability,
        without,
        held_out_scores,
        learned,
        last,
    )


def _slow(
    experiment: Experiment, specs: tuple[Spec, ...], system: System, dataset: Dataset | None, known: bool
) -> dict[str, float]:
    """Return the seconds of a step of slow models; of a run that exists, those found when it began."""
    if known or experiment.stop_after is not None:
        return dict(experiment.step_seconds)
    steps = round(60.0 * experiment.minutes / system.dt) if dataset is None else dataset.n_steps
    return times_of_steps(specs, system, dataset, steps, experiment.step_seconds)


def comparison_of(run: Path) -> tuple[Comparison, tuple[str, ...]]:
    """Return the comparison of a run folder, and remarks; its data are those in the folder.

    Raises `InvalidArgument` if it is no run, `ArtefactError` if its data are missing or damaged, `PluginError` if it
    names a plugin that is not trusted.
    """
    experiment = Experiment.of(Experiment.read(run))
    plugins = load_named_plugins(experiment.plugins, run / FILE)
    comparison, damaged = comparison_in(experiment.model_copy(update={"plugins": plugins}), run)
    return comparison, (*comparison.plan.remarks, *damaged)


def comparison_in(experiment: Experiment, run: Path) -> tuple[Comparison, tuple[str, ...]]:
    """Return the comparison whose data are in the folder ``run``, and remarks on damaged files there.

    Raises `ArtefactError` if the data are missing or damaged.
    """
    store = Store(run)
    record = store.find(experiment.data_digest or "")
    data = None if record is None else stored(record)
    if data is None or not store.done(data):
        raise ArtefactError(f"{run}: the data of this run are missing or damaged; repeat its command to prepare them")
    measured, damaged = load_measured(run)
    system = store.load(data).training.system
    return plan_comparison(experiment, held=(data, system), measured=measured), tuple(damaged)


def check_experiment(experiment: Experiment) -> None:
    """Raise errors in the names and parameters of ``experiment``: all checks that need no data."""
    check_settings(experiment, has_data=experiment.data is not None)
    robot = _robot(experiment, has_data=experiment.data is not None)
    if robot is not None:
        make_robot(robot)
    _constructible(evolution_settings(with_task(experiment, (robot,)) if experiment.stop_after is None else experiment))
    requested = requested_models(experiment)
    if requested is not None:
        for spec in requested:
            made_model(spec, experiment.preset)
        ensembles_of(experiment, tuple(spec.label for spec in requested))


def unsettled(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return stored settings without the values of their preset, so that another preset applies its own.

    Raises the errors of the registry of models for wrong names.
    """
    experiment = Experiment.of(settings)
    budget = BUDGETS[experiment.preset].model_dump()
    found = {name: value for name, value in settings.items() if name not in budget or value != budget[name]}
    if experiment.models is not None and experiment.models != (ALL,):
        specs = (without_preset(Spec.parse(text), experiment.preset) for text in experiment.models)
        found["models"] = tuple(map(str, specs))
    return found


def _constructible(evolution: ControllerEvolution) -> None:
    """Make everything that needs no system, so that wrong values are found now."""
    made(tasks, evolution.task)
    for start in evolution.all_starts:
        made(controllers, start.controller)
    make_aggregate(evolution.aggregate)


def _check_control(evolution: ControllerEvolution, system: System) -> None:
    """Raise if task, controller and strategy do not fit ``system``, with the alternative without controllers."""
    try:
        task = evolution.make_task(system)
    except IncompatibleTask as error:
        name = system.name or "NAME"
        own = (
            f". Recordings of a Gymnasium environment need its own: --task 'environment(id=\"{name}\")', and "
            "--plugin FILE if a file of yours registers it"
        )
        raise IncompatibleTask(
            f"{error}. Name a task that fits (--task), or compare --stop-after prediction"
            f"{own if system.motion is None else ''}"
        ) from error
    for start in evolution.all_starts:
        evolution.make_strategy(make_controller(start.controller).bind_to(task).n_parameters, 0, start.strategy)


def _farthest(dataset: Dataset | None, robot: Spec | None) -> Array | None:
    """Return the range of the states in the recordings, else on the emulated robot; None if neither is known yet.

    A robot that is too slow is not driven for this.
    """
    if dataset is not None:
        return recorded_state_range(dataset)
    if robot is None or Plant(robot.label, robot.name, robot=robot).step_seconds() > SLOW:
        return None
    return _farthest_driven(robots.get(robot.name), str(robot))


@lru_cache(maxsize=64)
def _farthest_driven(_factory: Callable[..., Any], robot: str) -> Array | None:
    """Return the range of the states on ``robot``, once for all plans of a study; the factory is part of the key."""
    dynamics = make_robot(robot_spec(robot)).dynamics
    return None if dynamics is None else simulated_state_range(dynamics)


def _robot(experiment: Experiment, *, has_data: bool) -> Spec | None:
    if experiment.robot is None:
        if experiment.reference and has_data:
            raise InvalidArgument("reference: name the emulated robot that it is evolved on with --robot")
        return None if has_data else robot_spec(DEFAULT_ROBOT)
    return robot_spec(experiment.robot)


def _robot_column(experiment: Experiment, robot: Spec | None, system: System, remarks: list[str]) -> Plant | None:
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
        return Plant(robot.label, robot.label, robot=robot)
    if experiment.reference:
        runner_of(robot)
    remarks.append(f"{robot.label} is a physical robot: its column is filled by sysid-evo drive --controller")
    return None


def _data(experiment: Experiment, robot: Spec | None, dataset: Dataset | None, *, whole: bool = False) -> Cell:
    """Return the cell of the recordings; ``whole`` ones are split later, with those of the rounds."""
    share = 0.0 if experiment.stop_after == "fit" and experiment.test is None else experiment.held_out
    split = HoldOut(None, 0.0) if whole else HoldOut(experiment.test, share)
    if dataset is None and experiment.test is not None:
        raise InvalidArgument("test: a recording that is still to be made has no named episodes; use --data for that")
    if share == 0.0 and experiment.test is None and experiment.stop_after != "fit":
        raise InvalidArgument("held_out: expected a share above 0, so that models can be tested")
    if dataset is None:
        recorded = robot or robot_spec(DEFAULT_ROBOT)
        make_robot(recorded).check()
        return RecordedData(recorded, experiment.seed, experiment.minutes, split).cell()
    parts = split.of(dataset)
    check_usable(parts.training, name="the training data")
    if parts.test is not None and experiment.stop_after != "fit":
        cases = measured_cases(parts.training, parts.test, PredictionProtocol())
        if not cases.horizons:
            raise InvalidData(
                f"test: no model can be evaluated on the held-out part: {cases.notes[0]}. "
                "Record more, or name a longer episode with --test"
            )
    return GivenData(dataset, split).cell()


def _conditions(experiment: Experiment, dataset: Dataset | None) -> int:
    """Return the number of conditions that are left out in turn, 0 for none. Raises `InvalidArgument` for only one."""
    if experiment.leave_out is None:
        return 0
    found = () if dataset is None else dataset.conditions
    if len(found) < 2:
        raise InvalidArgument(
            "leave_out: expected recordings of two or more conditions, got "
            f"{len(found)}: name them with sysid-evo import --condition NAME=PATTERN, and give the data set with --data"
        )
    return len(found)


TRIVIAL = {AT_REST: f"rest={AT_REST}", AT_RANDOM: AT_RANDOM}
"""Baselines that are always run, by the name of their controller: a choice must be better."""


def _baselines(
    experiment: Experiment,
    evolution: ControllerEvolution,
    system: System,
    fits: Mapping[str, Cell[Fit]],
    learned: Cell[LearnTask] | None,
) -> tuple[ControllerCell, ...]:
    """Return the cells of controllers that need no evolution. Raises if one cannot be made, or cannot do the task.

    Controllers with a model inside that is still to be fitted are checked when they are made. Controls at rest are
    included, unless their fitness is known to be zero, and so are random commands: a controller that is no better is
    useless, and shares are measured from rest.
    """
    specs = check_labels(tuple(Spec.parse(text) for text in experiment.baselines))
    task = evolution.make_task(system)
    if not task.rest_is_zero:
        known = {spec.name for spec in specs}
        specs = (*specs, *(Spec.parse(text) for name, text in TRIVIAL.items() if name not in known))
    cells = []
    for spec in specs:
        controllers.check(spec)
        inside = {label: fits[label] for label in labels_inside(spec, fits)}
        if inside:
            made(controllers, spec)
        else:
            try:
                Champion.baseline(spec, evolution.task, system)
            except UnknownName as error:
                raise UnknownName(f"baselines: {spec}: {error}; the models compared are {', '.join(fits)}") from error
        cells.append(Baseline(spec, evolution.task, system, inside, learned).cell())
    return tuple(cells)


def _taken(label: str, owner: str) -> str:
    return f"{owner} is called {label!r}, too: give the model or baseline a name of its own, NAME={label}"


def _matrix(
    experiment: Experiment,
    evolution: ControllerEvolution,
    models: tuple[Plant, ...],
    robot: Plant | None,
    searched: tuple[str, ...],
    ensembles: tuple[tuple[str, ...], ...],
    measured: tuple[MeasuredResult, ...],
    baselines: tuple[ControllerCell, ...],
    learned: Cell[LearnTask] | None,
    last: Cell[Round] | None,
    remarks: list[str],
    *,
    reference: bool,
) -> PlannedMatrix:
    by_label = {column.label: column for column in models}
    if robot is not None and robot.label in by_label:
        raise InvalidArgument(_taken(robot.label, "the robot"))
    columns = models if robot is None else (*models, robot)
    groups: list[tuple[Plant, ...]] = []
    inside = tuple(by_label[label] for label in searched)
    if last is None:
        groups += [(column,) for column in inside]
        groups += [tuple(by_label[member] for member in members) for members in ensembles]
    if robot is not None and reference:
        groups.append((robot,))
    evolved = tuple(
        Evolve(members, evolution_on(experiment, members), experiment.seed, learned).cell() for members in groups
    )
    champions: tuple[ControllerCell, ...] = evolved
    if experiment.budget.procedure == "recommended":
        champions = tuple(chosen_cell(experiment, (cell,), models) for cell in evolved)
        if len(inside) > 1:
            several = tuple(cell for cell in evolved if len(cell.settings.members) > 1)
            champions += (
                controller_cell(
                    experiment,
                    inside,
                    scoring_models=models,
                    label=POLISHED,
                    accurate_only=True,
                    further=several,
                    learned=learned,
                ),
            )
    if last is not None:
        champions = (ChooseRound(last, models, ROUNDS, learned).cell(), *champions)
    champions += baselines
    names = [champion.name for champion in champions]
    taken = [name for name in names if names.count(name) > 1]
    if taken:
        raise InvalidArgument(_taken(taken[0], "another controller"))
    on_robot = robot_trials(experiment, robot, evolution.task, len(champions), remarks)
    runs = tuple(
        Run(
            champion,
            column,
            delay=evolution.estimator_delay,
            trials=on_robot if column == robot else experiment.transfer_trials,
            traces=kept_traces(
                experiment.traces, own=column == robot or any(map(column.is_same, champion.settings.members))
            ),
            seed=experiment.seed,
            steps=steps_in(evolution.task, (column,)),
        ).cell()
        for champion in champions
        for column in columns
    )
    return PlannedMatrix(champions, columns, runs, None if robot is None else robot.label, measured)


LONGEST_REFERENCE = 600.0
"""Approximate time (s) up to which evolution on the robot itself is part of a comparison by default."""
LONGEST_RUNS = 240.0
"""Approximate time (s) on one processor of all runs of controllers on the robot, by default."""
FEWEST_TRIALS = 10
"""Trials of a controller on the robot, however long they take."""


def has_reference(experiment: Experiment, robot: Plant | None, remarks: list[str], *, recorded: bool) -> bool:
    """Return whether a controller is evolved on the robot itself; add a remark if that would take too long."""
    if robot is None or robot.robot is None or experiment.reference is not None:
        return robot is not None and bool(experiment.reference)
    usual = recorded and experiment.budget.procedure == "recommended" and make_robot(robot.robot).dynamics is not None
    own = Evolve((robot,), evolution_on(experiment, (robot,)), experiment.seed)
    about = own.cell().expected_seconds if usual else 0.0
    if about > LONGEST_REFERENCE:
        remarks.append(
            f"no controller is evolved on {robot.label} itself: a step of it takes {1e3 * robot.timed:.2g} ms, "
            f"so this would take about {about / 3600.0:.1f} hours. Use --reference yes to do it anyway"
        )
    return usual and about <= LONGEST_REFERENCE


def robot_trials(experiment: Experiment, robot: Plant | None, task: Spec, controllers: int, remarks: list[str]) -> int:
    """Return the number of trials of each of ``controllers`` on the robot; add a remark if it is reduced.

    It is that of the experiment if that was given, else what all of them do in `LONGEST_RUNS`, in tens.
    """
    if experiment.robot_trials is not None:
        return experiment.robot_trials
    usual = experiment.transfer_trials
    if robot is None or not robot.timed or "transfer_trials" in experiment.model_fields_set:
        return usual
    step, steps = robot.timed, steps_in(task, (robot,))
    found = min(usual, max(FEWEST_TRIALS, 10 * int(0.1 * LONGEST_RUNS / (step * steps * controllers))))
    if found < usual:
        remarks.append(
            f"each controller is run in {found} trials on {robot.label} instead of {usual}: a step of it takes "
            f"{1e3 * step:.2g} ms, a trial of {steps} steps {step * steps:.2g} s"
        )
    return found
