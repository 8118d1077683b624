"""How far a model is to be doubted where a controller drives, and what that costs (as in MOPO and MOReL)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from sysid_evo.arrays import Array, Seeds
from sysid_evo.dynamics import Dynamics
from sysid_evo.errors import InvalidArgument
from sysid_evo.registry import Registry
from sysid_evo.wrappers.cautious import Cautious
from sysid_evo.wrappers.supported import Supported

if TYPE_CHECKING:
    from sysid_evo.controllers.controller import Controller
    from sysid_evo.engine import Rollouts, Runner
    from sysid_evo.tasks.task import Task

cautions: Registry[Doubt] = Registry("caution", "sysid_evo.cautions")
"""What ``--caution`` may name."""


@cautions.register("doubt")
@dataclass(frozen=True)
class Doubt:
    """What a trial loses where its model cannot be believed, in units of fitness; 0 means nothing.

    ``outside``: of a trial that is outside the training data from beginning to end (`Supported`);
    ``disagreement``: of one in which the models disagree all the time (`Cautious`). What lies between costs its
    share of the steps. A trial goes on: one that leaves the data for a moment and comes back loses little.
    """

    outside: float = 0.0
    disagreement: float = 0.0

    def __post_init__(self) -> None:
        for name in ("outside", "disagreement"):
            value = getattr(self, name)
            if not isinstance(value, (int, float)) or isinstance(value, bool) or not 0 <= value < np.inf:
                raise InvalidArgument(f"caution: expected {name} to be a number >= 0, got {value!r}")

    @property
    def most(self) -> float:
        """What a trial loses at most."""
        return self.outside + self.disagreement

    def about(self, dynamics: Dynamics, others: Sequence[Dynamics] = ()) -> Dynamics:
        """Return ``dynamics`` with the doubt counted; a robot is not doubted.

        The ``others`` are further models of the ensemble; what is no model is left out. Raises `InvalidArgument` for
        a model that does not know its training data.
        """
        from sysid_evo.dynamics import DynamicsModel

        if getattr(dynamics, "pairs_", None) is None:
            if isinstance(dynamics, DynamicsModel):
                raise InvalidArgument(
                    f"caution: {type(dynamics).__name__} was stored without states of its training data: fit it again"
                )
            return dynamics
        inner = dynamics
        against = [other for other in others if getattr(other, "pairs_", None) is not None]
        if self.disagreement and against:
            inner = Cautious(inner, against, weight=self.disagreement)
        return Supported(inner, weight=self.outside) if self.outside else inner


@dataclass(frozen=True)
class Discounted:
    """A runner whose fitness is that of ``runner`` less the doubt: its mean over the steps of the task.

    A trial that diverges is in doubt from beginning to end and loses ``most``, so that it stays below all others.
    """

    runner: Runner
    most: float

    def run(
        self, controller: Controller, parameters: Array, task: Task, seeds: Seeds, *, record: bool = False
    ) -> Rollouts:
        """Run every candidate, see `Runner`."""
        run = self.runner.run(controller, parameters, task, seeds, record=record)
        if run.doubt.shape != run.fitness.shape:
            return run
        lost = np.where(run.fitness < task.worst, self.most, run.doubt / task.horizon)
        return replace(run, fitness=run.fitness - lost)
