"""Closed loop: controllers in a dynamics at a task, many candidates in many trials at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from sysid_evo.arrays import Array, IntArray, Seeds, check_shape
from sysid_evo.controllers.controller import Controller
from sysid_evo.data.trajectory import Trajectory
from sysid_evo.dynamics import Dynamics
from sysid_evo.engine import reference
from sysid_evo.errors import InvalidArgument
from sysid_evo.tasks.task import Task, TaskState


@dataclass(frozen=True)
class Rollouts:
    """What P candidates did in E trials.

    ``fitness`` (P, E) is never nan: a trial that diverged has ``task.worst - 1 + survived /
    horizon``, below any that did not. ``survived`` (P, E) steps; ``clipped`` (P, E) counts the
    steps whose state was clipped to the model's envelope. ``trajectories`` (only when recorded)
    stand candidate first, trial second; ``task_state`` is the last one. ``engine`` names the form
    that ran.
    """

    fitness: Array
    survived: IntArray
    clipped: IntArray
    task_state: TaskState
    engine: str
    trajectories: tuple[Trajectory, ...] = ()


class Runner(Protocol):
    """How a controller is run on something: a column of the transfer matrix."""

    def run(
        self, controller: Controller, parameters: Array, task: Task, seeds: Seeds, *, record: bool = False
    ) -> Rollouts:
        """Run every candidate (P, n_parameters) in a trial of every seed (E,)."""
        ...


@dataclass(frozen=True)
class DynamicsRunner:
    """Runs controllers on a `Dynamics`: a model or an emulated robot."""

    dynamics: Dynamics

    def run(
        self, controller: Controller, parameters: Array, task: Task, seeds: Seeds, *, record: bool = False
    ) -> Rollouts:
        """Run every candidate (P, n_parameters) in a trial of every seed (E,), see `rollout`."""
        return rollout(self.dynamics, controller, parameters, task, seeds, record=record)


def rollout(
    dynamics: Dynamics, controller: Controller, parameters: Array, task: Task, seeds: Seeds, *, record: bool = False
) -> Rollouts:
    """Run every candidate ``parameters`` (P, n_parameters) in a trial of every seed (E,).

    Candidates meet the same trials: waypoints, noise and draws depend on the trial's seed alone.
    Raises `IncompatibleTask`, `ShapeError`.
    """
    task = task.bind(dynamics.system)
    controller = controller.bind(len(task.observations), dynamics.system.nu)
    parameters = check_shape("parameters", parameters, (None, controller.n_parameters))
    if len(seeds) < 1:
        raise InvalidArgument("rollout: expected at least one trial seed, got none")
    return Rollouts(**reference.run(dynamics, controller, parameters, task, seeds, record=record))
