"""Systems in which controllers are evolved and run (models, simulated robots), and how well models predict."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from evaluation.prediction.scores import forecast_error
from sysid_evo.engine import DynamicsRunner, Runner
from sysid_evo.engine.rollout import SteppedRunner
from sysid_evo.errors import InvalidArgument
from sysid_evo.evolution import delayed_runner
from sysid_evo.models import Dynamics
from sysid_evo.plan import Cell, CellContext
from sysid_evo.processors import resolve
from sysid_evo.registry import Spec, make_robot, robot_spec, robots
from sysid_evo.system import System
from sysid_evo.tasks.task import make_task

ROLLOUT_STEPS_PER_SECOND = 2e7
"""Approximate rollout steps per second of a compiled model with a small controller, on one core."""
STEPS = 500
"""Approximate number of steps of a trial where a step takes next to no time."""
SLOW = 1e-3
"""Duration of a step (s) from which a robot is not driven for a plan: 1 s for two controls, 24 s for five."""


@dataclass(frozen=True)
class Plant:
    """A column of the transfer matrix: the model of the cell ``model``, or the ``robot``.

    ``family`` is the registered name of a model's family; a robot is its own family. ``prediction`` is the cell of
    the model's prediction error, where there is one. ``slow`` are the seconds of one step of one trial of a model
    whose step takes long, 0 for others.
    """

    label: str
    family: str
    model: Cell | None = None
    robot: Spec | None = None
    prediction: Cell | None = None
    slow: float = 0.0

    @property
    def needs(self) -> tuple[Cell, ...]:
        """The cell of the model, if it is one."""
        return () if self.model is None else (self.model,)

    @property
    def needs_with_prediction(self) -> tuple[Cell, ...]:
        """The cells that are needed to decide whether the model is accurate."""
        return self.needs if self.prediction is None else (*self.needs, self.prediction)

    @property
    def registered(self) -> str:
        """The registered name of the model's family or of the robot: it does not change with the label."""
        return self.family if self.robot is None else self.robot.name

    def inputs(self) -> dict[str, Any]:
        """Return what determines the behaviour of the column, besides the cells it needs, as strict JSON."""
        return {"robot": None if self.robot is None else robots.identity(self.robot)}

    def is_same(self, other: Plant) -> bool:
        """Return whether both are the same model or robot, whatever their labels."""
        return self.model == other.model and self.inputs() == other.inputs()

    def system(self, work: CellContext) -> System:
        """Return the system of the model or of the robot."""
        if self.model is not None:
            model: Dynamics = work.result(self.model)
            return model.system
        assert self.robot is not None
        system: System = make_robot(self.robot).system
        return system

    @property
    def timed(self) -> float:
        """Measured seconds of one step of one trial on a robot that is not compiled; else 0."""
        return 0.0 if self.robot is None else _timed(robots.get(self.robot.name), str(self.robot), resolve())

    def step_seconds(self) -> float:
        """Return the approximate seconds of one step of one trial."""
        return self.slow or self.timed or 1.0 / ROLLOUT_STEPS_PER_SECOND

    def runner(self, work: CellContext, *, delay: float, reported: bool = False) -> Runner:
        """Return the runner of this column, with states observed ``delay`` s late.

        With ``reported`` a robot that is stepped reports its steps as the progress of the work.
        """
        if self.model is not None:
            return delayed_runner(self.label, DynamicsRunner(work.result(self.model)), delay)
        assert self.robot is not None
        runner = runner_of(self.robot)
        if reported and isinstance(runner, SteppedRunner):
            runner = runner.reporting(work.progress)
        return delayed_runner(self.label, runner, delay)


def steps_in(task: Spec, columns: Iterable[Plant]) -> int:
    """Return the steps of a trial for which time is planned: if no robot among them was timed, at least `STEPS`."""
    horizon = make_task(task).horizon
    return horizon if any(column.timed for column in columns) else max(STEPS, horizon)


def runners(columns: Iterable[Plant], work: CellContext) -> dict[str, Runner]:
    """Return the runner of each of ``columns``, without delay of the states."""
    return {column.label: column.runner(work, delay=0.0) for column in columns}


def fitted(columns: Iterable[Plant], work: CellContext) -> list[Plant]:
    """Return those of ``columns`` that are available: robots, and models that could be fitted."""
    return [column for column in columns if column.model is None or work.result(column.model) is not None]


def labels_of(columns: Iterable[Plant]) -> tuple[str, ...]:
    """Return the labels of ``columns``."""
    return tuple(column.label for column in columns)


@lru_cache(maxsize=64)
def _timed(_factory: Callable[..., Any], robot: str, _engine: str) -> float:
    """Return `Robot.step_seconds`, once for all cells; the factory is in the key as two plugins may use one name."""
    return float(make_robot(robot_spec(robot)).step_seconds())


def runner_of(spec: Spec) -> Runner:
    """Return the runner of a simulated robot. Raises `InvalidArgument` for a physical one."""
    runner: Runner | None = make_robot(spec).runner()
    if runner is None:
        raise InvalidArgument(
            f"{spec} is a physical robot: controllers are evolved in models and driven on it with sysid-evo drive"
        )
    return runner


def emulated(spec: Spec) -> Dynamics:
    """Return the dynamics of an emulated robot. Raises `InvalidArgument` for any other."""
    runner_of(spec)
    dynamics: Dynamics | None = make_robot(spec).dynamics
    if dynamics is None:
        raise InvalidArgument(f"{spec} is no model and no emulated robot: its equations are not known")
    return dynamics


ACCURATE = 1.5
"""Ratio of a model's error to that of the best model up to which it is accurate."""
FAMILIES = 2
"""The best models of this many families always count as accurate: each needs one of another family to score it."""


def accurate_plants(columns: Sequence[Plant], work: CellContext) -> tuple[Plant, ...]:
    """Return those of ``columns`` that predict well: N at most `ACCURATE` times that of the best.

    A model that lacks a lag or a force of the robot is no evidence on fast controllers, and several such models agree
    with each other: their median would overrate controllers that exploit this. Robots, models of unknown error and
    the best models of two families are always included; models that fail the `SanityCheck` only if fewer than two
    families pass.
    """
    errors = {column.label: error for column in columns if (error := prediction_error(column, work)) is not None}
    if not errors:
        return tuple(columns)
    families: dict[str, float] = {}
    for column in columns:
        if column.label in errors:
            families[column.registered] = min(families.get(column.registered, float("inf")), errors[column.label])
    enough = sorted(families.values())[:FAMILIES][-1]
    limit = max(enough, ACCURATE * min(errors.values()))
    return tuple(column for column in columns if errors.get(column.label, 0.0) <= limit)


def prediction_error(column: Plant, work: CellContext) -> float | None:
    """Return N of a model on held-out data, None if it is not known, infinite if it fails the `SanityCheck`."""
    return None if column.prediction is None else forecast_error(work.result(column.prediction))
