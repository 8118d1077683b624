"""What controllers are evolved in and run on, a model or a robot that is a program; which models predict well."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from evaluation.prediction.scores import error_of
from sysid_evo.engine import DynamicsRunner, Runner
from sysid_evo.errors import InvalidArgument
from sysid_evo.evolution import delayed_runner
from sysid_evo.models import Dynamics
from sysid_evo.plan import Cell, CellContext
from sysid_evo.processors import resolve
from sysid_evo.registry import Spec, make_robot, robot_spec, robots
from sysid_evo.system import System

ROLLOUT_STEPS_PER_SECOND = 2e7
"""Of compiled models with a small controller, about, on one core."""
STEPS = 500
"""Steps of a trial, about."""


@dataclass(frozen=True)
class Plant:
    """A column of the transfer matrix: the model that the cell ``model`` gives, or the ``robot``.

    ``family`` is the registered name behind a model; that of a robot is its own. ``prediction`` is the cell of
    how well the model predicts, where that is known.
    """

    label: str
    family: str
    model: Cell | None = None
    robot: Spec | None = None
    prediction: Cell | None = None

    @property
    def needs(self) -> tuple[Cell, ...]:
        """The cell of the model, if it is one."""
        return () if self.model is None else (self.model,)

    @property
    def needs_with_prediction(self) -> tuple[Cell, ...]:
        """The cells that must be there to say whether the model is believed."""
        return self.needs if self.prediction is None else (*self.needs, self.prediction)

    @property
    def registered(self) -> str:
        """The registered name of the model's family or of the robot: it does not change with the label."""
        return self.family if self.robot is None else self.robot.name

    def inputs(self) -> dict[str, Any]:
        """Return what decides how the column behaves, beside the cells it needs, as strict JSON."""
        return {"robot": None if self.robot is None else robots.identity(self.robot)}

    def is_same(self, other: Plant) -> bool:
        """Whether the same model or robot stands behind both, whatever their labels."""
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
        """Seconds of one step of one trial on a robot that is not compiled, measured; else 0."""
        return 0.0 if self.robot is None else _timed(robots.get(self.robot.name), str(self.robot), resolve())

    def step_seconds(self) -> float:
        """Return about how long one step of one trial takes."""
        return self.timed or 1.0 / ROLLOUT_STEPS_PER_SECOND

    def runner(self, work: CellContext, *, delay: float) -> Runner:
        """Return how controllers are run here, with states observed ``delay`` s late."""
        if self.model is not None:
            return delayed_runner(self.label, DynamicsRunner(work.result(self.model)), delay)
        assert self.robot is not None
        return delayed_runner(self.label, runner_of(self.robot), delay)


def runners(columns: Iterable[Plant], work: CellContext) -> dict[str, Runner]:
    """Return how controllers are run on each of ``columns``, with states observed at once."""
    return {column.label: column.runner(work, delay=0.0) for column in columns}


def fitted(columns: Iterable[Plant], work: CellContext) -> list[Plant]:
    """Return those of ``columns`` that are there: robots, and models that could be fitted."""
    return [column for column in columns if column.model is None or work.result(column.model) is not None]


def labels_of(columns: Iterable[Plant]) -> tuple[str, ...]:
    """Return how ``columns`` are called."""
    return tuple(column.label for column in columns)


@lru_cache(maxsize=64)
def _timed(_factory: Callable[..., Any], robot: str, _engine: str) -> float:
    """Return `Robot.step_seconds`, once for all cells; the factory is in the key as two plugins may use one name."""
    return float(make_robot(robot_spec(robot)).step_seconds())


def runner_of(spec: Spec) -> Runner:
    """Return how controllers are run on a robot that is a program. Raises `InvalidArgument` for a physical one."""
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


BELIEVED = 1.5
"""How many times the error of the best model a model may have to be believed."""
FAMILIES = 2
"""The best of this many families are always believed, so that there is one to judge what comes from the other."""


def accurate_plants(columns: Sequence[Plant], work: CellContext) -> tuple[Plant, ...]:
    """Return those of ``columns`` that predict well: N at most `BELIEVED` times that of the best.

    A model that misses a lag or a force of the robot tells nothing about fast controllers, and several such models
    agree on it: their median would overrate what exploits it. Robots, and models whose error is not known, are
    believed. So are the best models of two families in any case.
    """
    errors = {column.label: error for column in columns if (error := prediction_error(column, work)) is not None}
    if not errors:
        return tuple(columns)
    families: dict[str, float] = {}
    for column in columns:
        if column.label in errors:
            families[column.registered] = min(families.get(column.registered, float("inf")), errors[column.label])
    enough = sorted(families.values())[:FAMILIES][-1]
    limit = max(enough, BELIEVED * min(errors.values()))
    return tuple(column for column in columns if errors.get(column.label, 0.0) <= limit)


def prediction_error(column: Plant, work: CellContext) -> float | None:
    """Return N of a model on held-out data, None where it is not known."""
    return None if column.prediction is None else error_of(work.result(column.prediction))
