"""The contract of a task: what to achieve, how to observe it, when it is over; what can be drawn of a trial."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar, Self

import numpy as np

from sysid_evo.errors import IncompatibleTask
from sysid_evo.kernels import TaskKernel
from sysid_evo.registry.grammar import Spec
from sysid_evo.registry.registry import tasks
from sysid_evo.system import Channel, System
from sysid_evo.types import Array, BoolArray, Seeds


@dataclass(frozen=True)
class TaskState:
    """Where a batch of B trials stands. Tasks add fields of leading length B, or shared ones.

    ``state`` (B, nx) is the start state, ``pose`` (B, n_pose), ``alive`` (B,) is false once a trial
    is over. A field in `shared` is common to all copies of a trial and never repeated.
    """

    shared: ClassVar[frozenset[str]] = frozenset()

    state: Array
    pose: Array
    alive: BoolArray

    def tile(self, copies: int) -> Self:
        """Return the trials of every one of ``copies`` candidates: candidate first, trial second."""
        changed = {}
        for item in fields(self):
            value = getattr(self, item.name)
            if item.name not in self.shared:
                changed[item.name] = np.tile(value, (copies,) + (1,) * (value.ndim - 1))
        return replace(self, **changed)

    def only(self, trial: int) -> Self:
        """Return one of the trials."""
        one = slice(trial, trial + 1)
        return replace(
            self, **{item.name: getattr(self, item.name)[one] for item in fields(self) if item.name not in self.shared}
        )

    def updated_where(self, advanced: Self, going: BoolArray) -> Self:
        """Return ``advanced`` for the trials in ``going`` (B,), and this state for all others."""
        changed = {}
        for item in fields(self):
            old, new = getattr(self, item.name), getattr(advanced, item.name)
            if item.name not in self.shared:
                changed[item.name] = np.where(going.reshape(-1, *[1] * (old.ndim - 1)), new, old)
        return replace(advanced, **changed)


class Task(ABC):
    """What to achieve in ``horizon`` steps; `fitness` is maximised and never below ``worst``.

    ``max_fitness`` is the most that a trial can bring, if a good controller brings it in every trial; infinite by
    default. ``rest_is_zero`` says that controls at rest are known to bring nothing, so that they need not be tried.
    """

    default_noise: ClassVar[str] = ""
    """What candidates meet in models at this task where no noise is named, see `DomainRandomisation`; empty for
    none."""

    horizon: int
    worst: float = 0.0
    max_fitness: float = np.inf
    rest_is_zero: bool = False
    fitness_unit: str = ""
    observations: tuple[Channel, ...]
    system: System

    def bind(self, system: System) -> Self:
        """Return this task on ``system``; raises `IncompatibleTask` naming the role it lacks."""
        self.check_system(system)
        bound = copy.copy(self)
        bound.system = system
        return bound

    @abstractmethod
    def check_system(self, system: System) -> None:
        """Raise `IncompatibleTask` if ``system`` lacks a role that this task needs."""

    @abstractmethod
    def begin(self, seeds: Seeds) -> TaskState:
        """Return one trial for each of the seeds (E,): start state, pose, and what the task draws."""

    @abstractmethod
    def observe(self, task_state: Any, state: Array) -> Array:
        """Return what the controller is given, (B, len(observations)), in state (B, nx).

        Here and below, ``task_state`` is what `begin` of the same task made: a task may name its own class.
        """

    def formulas(self) -> Mapping[str, str]:
        """Return how observations are computed from states and targets, by their names.

        It stands in the head of an exported controller. Those whose name says it are left out. The task is bound.
        """
        return {}

    @abstractmethod
    def advance(
        self, task_state: Any, before: Array, after: Array, *, control: Array, pose: Array | None = None
    ) -> tuple[TaskState, Array]:
        """Return the trials one step on, and the state (B, nx), which a wall may have altered.

        ``control`` (B, nu) led from the state ``before`` to the one ``after``. ``pose`` (B, n_pose) is
        where a tracker saw the robots after the step; without one the motion
        moves them.
        """

    @abstractmethod
    def fitness(self, task_state: Any) -> Array:
        """Return the fitness (B,) so far."""

    def hide_future(self, task_state: TaskState) -> TaskState:
        """Return the trials with only what may be known of their future, for controllers that look ahead.

        By default nothing is hidden. A task that reveals its goals one after the other hides the later ones.
        """
        return task_state

    def potential(self, task_state: TaskState, state: Array) -> Array:
        """Return how near more fitness is in state (B, nx), in units of fitness and below 1, (B,); 0 by default.

        It tells a controller that looks ahead only a few steps which way to go.
        """
        return np.zeros(len(state))

    def feasibility_warnings(self, farthest: Array) -> tuple[str, ...]:
        """Return in sentences why the bound task cannot be done well by this robot; none by default.

        ``farthest`` (nx,) is the largest absolute value that each state was seen to reach.
        """
        return ()

    def measures(self, task_state: TaskState) -> Mapping[str, Array]:
        """Return what else is to be told of each trial, by its name with the unit in brackets, (B,) each.

        nan where a trial has none. Nothing by default; the task is bound.
        """
        return {}

    def scene(self, task_state: TaskState, trial: int) -> Scene:
        """Return what can be drawn of one trial, the row ``trial`` of ``task_state``; nothing by default.

        The task need not be bound.
        """
        return Scene()

    def kernel(self) -> TaskKernel[Any] | None:
        """Return the compiled form of a bound task, if it has one."""
        return None


@dataclass(frozen=True)
class Target:
    """Where a state was wanted: its ``channel``, its ``place`` among the states, and what it was to be.

    ``values`` (K,) holds one for each sample, or one for all of them; an error below ``tolerance`` counts as met.
    """

    channel: Channel
    place: int
    values: Array
    tolerance: float


@dataclass(frozen=True)
class Scene:
    """Places in a trial, in m from the task's origin, and targets of states; a task without any has an empty scene.

    ``markers`` (k, 2) are places to be reached, in order: the first ``reached`` of them were, the others
    lie ahead. ``radius`` is that of each marker, 0 for a point. What happens stays within ``extent`` of
    the origin, None where that is not known. ``walls`` are lines (k, 2); ``targets`` what states were to be.
    """

    markers: Array = field(default_factory=lambda: np.empty((0, 2)))
    reached: int = 0
    radius: float = 0.0
    extent: float | None = None
    walls: tuple[Array, ...] = ()
    targets: tuple[Target, ...] = ()

    @property
    def next_marker(self) -> Array | None:
        """The first marker that lies ahead, (2,) m; None if there is none."""
        return self.markers[self.reached] if self.reached < len(self.markers) else None


POSE = ("x", "y", "heading")


def planar_places(task: str, system: System) -> dict[str, int]:
    """Return where the states that move a planar body stand, by their roles. Raises `IncompatibleTask` without one."""
    motion = system.motion
    if motion is None or motion.pose_names != POSE or not {"forward", "yaw_rate"} <= motion.roles().keys():
        raise IncompatibleTask(
            f"{task} needs a planar body (roles forward and yaw_rate); {system.name or 'this system'} has "
            f"{'no motion' if motion is None else motion.kind}"
        )
    return {role: system.state_names.index(name) for role, name in motion.roles().items()}


def make_task(spec: str | Spec, /, **parameters: Any) -> Task:
    """Return the task that ``spec`` names, made with its parameters and these; see `Registry.make`."""
    made: Task = tasks.make(spec, **parameters)
    return made
