"""What controllers are evolved against and run on: a fitted model, or an emulated robot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from sysid_evo.dynamics import Dynamics
from sysid_evo.engine import DynamicsRunner, Runner
from sysid_evo.errors import InvalidArgument
from sysid_evo.evolution import observed_late
from sysid_evo.plan import Cell, Work
from sysid_evo.registry import Spec, make_robot, robots


@dataclass(frozen=True)
class Column:
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
    def believing(self) -> tuple[Cell, ...]:
        """The cells that must be there to say whether the model is believed."""
        return self.needs if self.prediction is None else (*self.needs, self.prediction)

    @property
    def registered(self) -> str:
        """The registered name of the model's family or of the robot: it does not change with the label."""
        return self.family if self.robot is None else self.robot.name

    def inputs(self) -> dict[str, Any]:
        """Return what decides how the column behaves, beside the cells it needs, as strict JSON."""
        return {"robot": None if self.robot is None else robots.identity(self.robot)}

    def dynamics(self, work: Work) -> Dynamics:
        """Return the model or the emulated robot."""
        if self.model is not None:
            model: Dynamics = work.result(self.model)
            return model
        assert self.robot is not None
        return emulated(self.robot)

    def runner(self, work: Work, *, delay: float) -> Runner:
        """Return how controllers are run here, with states observed ``delay`` s late."""
        return observed_late(self.label, DynamicsRunner(self.dynamics(work)), delay)


def emulated(spec: Spec) -> Dynamics:
    """Return the dynamics of an emulated robot. Raises `InvalidArgument` for a physical one."""
    dynamics: Dynamics | None = make_robot(spec).dynamics
    if dynamics is None:
        raise InvalidArgument(
            f"{spec} is a physical robot: controllers are evolved in models and driven on it with sysid-evo drive"
        )
    return dynamics
