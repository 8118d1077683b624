"""Evolution of one controller, or search for one exploit, on members of a run: its plan and its result."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from evaluation.advice.evidence import Remark
from evaluation.advice.regions import driven_outside
from evaluation.cells.assessment import Run, SearchExploit
from evaluation.cells.controllers import (
    Choose,
    ControllerCell,
    Polish,
    controller_cell,
    evolution_settings,
    with_starts,
)
from evaluation.cells.learned_task import LearnTask, learning_cell
from evaluation.cells.plants import Plant
from evaluation.cells.slow_models import slow_remarks
from evaluation.experiment import Experiment, with_task
from evaluation.exploitability.assessment import assess_exploitability
from evaluation.exploitability.results import ModelExploitability
from evaluation.formatting import with_interval
from evaluation.members import (
    check_evolution,
    data_of,
    dynamics_of,
    find_column,
    has_dynamics,
    other_models,
    system_of,
)
from evaluation.prediction.scores import forecast_error
from evaluation.run_folder import run_of_controller, stored_settings
from evaluation.steps import Steps
from evaluation.transfer.forecast import Forecast, forecasts
from evaluation.transfer.matrix import TransferMatrix, TransferResult, transfer, transfer_seeds
from sysid_evo.controllers.controller import make_controller
from sysid_evo.data import Trajectory
from sysid_evo.data.support import Support, split_pairs
from sysid_evo.engine import DynamicsRunner
from sysid_evo.errors import InvalidArgument
from sysid_evo.evolution import Champion, delayed_runner
from sysid_evo.evolution.champion import load_champion
from sysid_evo.models import Dynamics, DynamicsModel
from sysid_evo.plan import Cell, Plan, Store, stored
from sysid_evo.system import System
from sysid_evo.tasks.task import make_task

CLAIM_TRIALS = 100

TRIALS = 10
"""Number of trials in each model that show where a controller drives."""


@dataclass(frozen=True)
class EvolutionPlan:
    """Cells of a controller against ``columns``, of its claims there, and of its runs on the run's other models.

    ``remarks`` are sentences on limits of its task there.
    """

    columns: tuple[Plant, ...]
    champion: ControllerCell
    claims: tuple[Cell[Run], ...]
    elsewhere: tuple[Cell[Run], ...]
    plan: Plan
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True)
class EvolutionResult:
    """Result of an evolution: the claims by column, their unit, and the forecast, None if there is none.

    ``chosen`` is the number of finalists that the controller was chosen from by their forecasts, 0 if it was not.
    ``remarks`` advise what to record next.
    """

    claims: Mapping[str, TransferResult]
    unit: str
    forecast: Forecast | None
    chosen: int
    remarks: tuple[Remark, ...]

    @property
    def forecast_sentence(self) -> str:
        """The expected fitness on the robot, with the number of models and of finalists, in words."""
        if self.forecast is None:
            return ""
        found = self.forecast
        size = f"{with_interval(found.value, found.low, found.high)} {self.unit}".rstrip()
        among = f"; chosen from {self.chosen} finalists by their forecasts" if self.chosen > 1 else ""
        return f"Forecast for the robot, by {len(found.weights)} models: {size}{among}"


def plan_evolution(experiment: Experiment, store: Store, members: Sequence[str]) -> EvolutionPlan:
    """Return the plan of a controller against ``members`` of a run, of its claims, and of its forecast elsewhere.

    A controller evolved on a robot is run nowhere else and has no forecast. Nothing is computed. Raises the errors of
    `find_column` and `check_evolution`.
    """
    columns = tuple(find_column(store, member) for member in members)
    robots = [column.robot for column in columns]
    task = experiment.task or stored_settings(store.path).get("task")
    experiment = with_task(experiment.model_copy(update={"task": task}), robots)
    robot = next(filter(None, robots), None)
    experiment = with_starts(experiment, system_of(store, columns[0]), robot)
    remarks = (
        *check_evolution(store, columns, evolution_settings(experiment)),
        *slow_remarks(experiment, columns),
    )
    others = other_models(store, columns)
    learned = _learned(experiment, store)
    champion = controller_cell(experiment, columns, scoring_models=columns + others, learned=learned)

    def on(column: Plant) -> Cell[Run]:
        return Run(champion, column, experiment.estimator_delay, CLAIM_TRIALS, 0, experiment.seed).cell()

    labels = {column.label for column in columns}
    first = list({column.label: column for column in reversed(others)}.values())[::-1]  # of each label
    on_models = all(column.robot is None for column in columns)
    claims = tuple(map(on, columns))
    elsewhere = tuple(on(column) for column in first if on_models and column.label not in labels)
    scored_runs = (*claims, *elsewhere) if on_models else ()
    predictions = [found for run in scored_runs if (found := run.settings.column.prediction) is not None]
    plan = Plan.of([champion, *claims, *elsewhere, *predictions])
    return EvolutionPlan(columns, champion, claims, elsewhere, plan, remarks)


def _learned(experiment: Experiment, store: Store) -> Cell[LearnTask] | None:
    """Return the cell in which the task learns its reward from the data of the run in ``store``."""
    record = store.find(stored_settings(store.path).get("data_digest", ""))
    data = None if record is None else stored(record)
    task = evolution_settings(experiment).task
    return None if data is None else learning_cell(task, experiment.search_minutes, data)


def evolution_result(planned: EvolutionPlan, store: Store) -> EvolutionResult:
    """Return the results in ``store`` of an evolution whose controller is there."""
    champion, columns = store.outcome(planned.champion).value, planned.columns
    claims = {
        cell.settings.column.label: claim for cell in planned.claims if (claim := store.outcome(cell).value) is not None
    }
    on_models = all(column.robot is None for column in columns)
    models = {column.label: dynamics_of(store, column) for column in columns if has_dynamics(column)}
    settings = planned.champion.settings
    choice = settings.chosen if isinstance(settings, Polish) else planned.champion
    finalists = store.outcome(choice).value.finalists if isinstance(choice.settings, Choose) else ()
    return EvolutionResult(
        claims=claims,
        unit=next((claim.unit for claim in reversed(claims.values())), ""),
        forecast=forecast_from(store, champion, (*planned.claims, *planned.elsewhere) if on_models else ()),
        chosen=sum(one.forecast is not None for one in finalists),
        remarks=_what_to_record(champion, models),
    )


def forecast_from(store: Store, champion: Champion, runs: Sequence[Cell[Run]]) -> Forecast | None:
    """Return the forecast of ``champion`` from its ``runs`` in models that ``store`` has, None for fewer than two."""
    found = {
        run.settings.column.label: (run.settings.column, cell)
        for run in runs
        if (cell := store.outcome(run).value) is not None
    }
    errors = {
        label: forecast_error(None if column.prediction is None else store.outcome(column.prediction).value)
        for label, (column, _) in found.items()
    }
    matrix = TransferMatrix.of(
        [champion],
        tuple(found),
        [cell for _, cell in found.values()],
        families={label: column.registered for label, (column, _) in found.items()},
    )
    return forecasts(matrix, errors).get(champion.name)


def _what_to_record(champion: Champion, models: Mapping[str, Dynamics]) -> tuple[Remark, ...]:
    """Return remarks on where ``champion`` leaves the data of the first of ``models`` that was fitted to data."""
    fitted = [
        model for model in models.values() if isinstance(model, DynamicsModel) and hasattr(model, "training_sample_")
    ]
    if not fitted:
        return ()
    system = fitted[0].system
    visited = Steps.of(system, _driven(champion, models))
    found = driven_outside(visited, Support.of(system, *split_pairs(system, fitted[0].training_sample_)))
    return () if found is None else (found,)


def _driven(champion: Champion, models: Mapping[str, Dynamics]) -> Iterator[Trajectory]:
    """Yield the trials of ``champion`` in those of ``models`` that were fitted to data."""
    task, law, seeds = make_task(champion.task), make_controller(champion.controller), transfer_seeds(0, TRIALS)
    for label, model in models.items():
        if isinstance(model, DynamicsModel):
            runner = delayed_runner(label, DynamicsRunner(model), champion.estimator_delay)
            yield from runner.bind(law, task)(champion.parameters[None], seeds, record=True).trajectories


def driven_by(controller: Path, system: System) -> tuple[Trajectory, ...]:
    """Return trials of the controller in a file of a run, in the models that it was evolved in.

    Raises `InvalidArgument` if they are not in its run, `IncompatibleSystem` if it drives another ``system``.
    """
    champion = load_champion(controller)
    champion.check_system(system)
    folder = run_of_controller(controller)
    if folder is None:
        raise InvalidArgument(
            f"--controller: expected a file in controllers/ of a run that contains its models, too, got {controller}"
        )
    store = Store(folder)
    return tuple(
        _driven(champion, {label: dynamics_of(store, find_column(store, label)) for label in champion.against})
    )


@dataclass(frozen=True)
class ExploitPlan:
    """The cell of a controller that gains most in the model ``target``, and the models for comparison."""

    target: Plant
    others: tuple[Plant, ...]
    cell: Cell[SearchExploit]


def plan_exploit(experiment: Experiment, store: Store, model: str) -> ExploitPlan:
    """Return the search for a controller that gains in ``model`` of a run and in no model of another family."""
    target = find_column(store, model)
    others = tuple(one for one in other_models(store, (target,)) if one.registered != target.registered)
    evolution = evolution_settings(experiment)
    check_evolution(store, (target,), evolution)
    return ExploitPlan(target, others, SearchExploit(target, others, evolution, experiment.seed).cell())


def exploit_result(
    planned: ExploitPlan, store: Store, *, seed: int, robot: str | None = None
) -> tuple[TransferMatrix, ModelExploitability | None]:
    """Run the controller everywhere, and assess its behaviour in the model with the data that it was fitted to.

    ``robot`` names an emulated robot to run it on, too. There is no assessment if the model's data are not in the run.
    """
    target = planned.target
    columns = (target, *planned.others, *(() if robot is None else (find_column(store, robot),)))
    models = {column.label: dynamics_of(store, column) for column in columns}
    on_robot = None if robot is None else columns[-1].label
    matrix = transfer(
        [store.load(planned.cell)],
        {label: DynamicsRunner(dynamics) for label, dynamics in models.items()},
        seed=seed,
        families={column.label: column.registered for column in columns},
        robot=on_robot,
    )
    own = None if target.model is None else store.find(target.model.digest)
    data = None if own is None else data_of(store, own)
    if data is None:
        return matrix, None
    parts = store.load(data)
    looked = assess_exploitability(matrix, parts.training, parts.test)
    return matrix, next(one for one in looked if one.model == target.label)
