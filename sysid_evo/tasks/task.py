"""The base class of tasks: fitness, observations, end of a trial; the scene in which a trial is drawn."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar, Self

import numpy as np

from sysid_evo.data import Dataset
from sysid_evo.errors import IncompatibleTask
from sysid_evo.kernels import TaskKernel
from sysid_evo.registry.grammar import Spec
from sysid_evo.registry.registry import tasks
from sysid_evo.system import Channel, System
from sysid_evo.tasks.raw import RawInterface
from sysid_evo.types import Array, BoolArray, Seeds


@dataclass(frozen=True)
class TaskState:
    """State of a batch of B trials. Tasks add fields of leading length B, or shared ones.

    ``state`` (B, nx) is the start state, ``pose`` (B, n_pose), ``alive`` (B,) is false once a trial
    is over. A field in `shared` is common to all copies of a trial and never repeated.
    """

    shared: ClassVar[frozenset[str]] = frozenset()

    state: Array
    pose: Array
    alive: BoolArray

    def tile(self, copies: int) -> Self:
        """Return the trials repeated for each of ``copies`` candidates: candidate first, trial second."""
        own = self._own().items()
        return replace(self, **{name: np.tile(value, (copies,) + (1,) * (value.ndim - 1)) for name, value in own})

    def only(self, trial: int) -> Self:
        """Return the state of one trial."""
        return replace(self, **{name: value[trial : trial + 1] for name, value in self._own().items()})

    def updated_where(self, advanced: Self, active: BoolArray) -> Self:
        """Return ``advanced`` for the trials in ``active`` (B,), and this state for all others."""
        changed = {}
        for name, old in self._own().items():
            changed[name] = np.where(active.reshape(-1, *[1] * (old.ndim - 1)), getattr(advanced, name), old)
        return replace(advanced, **changed)

    def _own(self) -> dict[str, Any]:
        """Return the fields that are not `shared`, by name."""
        return {item.name: getattr(self, item.name) for item in fields(self) if item.name not in self.shared}


class Task(ABC):
    """Base class of tasks of ``horizon`` steps; `fitness` is maximised and never below ``worst``.

    ``rest_is_zero``: controls at rest have fitness 0, so they need not be simulated.
    """

    default_noise: ClassVar[str] = ""
    """Noise of models in evolution, unless the user names another, see `DomainRandomisation`; empty for none."""

    needs_recording: bool = False
    """Whether the reward is learned from a recording before controllers are evolved, see `learn`."""

    pays_at_limit: bool = False
    """Whether the last step has a reward of its own, which trials that are shorter than the default never get."""

    horizon: int
    worst: float = 0.0
    rest_is_zero: bool = False
    fitness_unit: str = ""
    observations: tuple[Channel, ...]
    system: System

    def bind(self, system: System) -> Self:
        """Return this task on ``system``.

        Raises `IncompatibleTask` with the role that it lacks, `IncompatibleSystem` if it has `System.advance`.
        """
        system.check_causal("controllers")
        self.check_system(system)
        bound = copy.copy(self)
        bound.system = system
        return bound

    @abstractmethod
    def check_system(self, system: System) -> None:
        """Raise `IncompatibleTask` if ``system`` lacks a role that this task needs."""

    @abstractmethod
    def begin(self, seeds: Seeds) -> TaskState:
        """Return one trial for each of the seeds (E,): start state, pose, and random values of the task."""

    @abstractmethod
    def observe(self, task_state: Any, state: Array) -> Array:
        """Return the observations (B, len(observations)) of the controller in ``state`` (B, nx).

        Here and below, ``task_state`` comes from `begin` of the same task; a task may declare its own class.
        """

    def observation_sizes(self) -> Array:
        """Return the size of each observation (n,) that a search begins with: 1, or more if it is larger by its unit.

        The first weights of an observation are smaller by this factor, so that it does not saturate all outputs. The
        task is bound.
        """
        return np.ones(len(self.observations))

    def formulas(self) -> Mapping[str, str]:
        """Return the formulas of observations in terms of states and targets, by name; the task is bound.

        They are printed at the top of an exported controller. Observations with self-explanatory names have none.
        """
        return {}

    @abstractmethod
    def advance(
        self, task_state: Any, before: Array, after: Array, *, control: Array, pose: Array | None = None
    ) -> tuple[TaskState, Array]:
        """Return the trials after one step, and the state (B, nx), which a wall may have changed.

        ``control`` (B, nu) was applied between the states ``before`` and ``after``. ``pose`` (B, n_pose) is the pose
        measured by a tracker after the step; without one it is computed by the motion.
        """

    @abstractmethod
    def fitness(self, task_state: Any) -> Array:
        """Return the fitness (B,) so far."""

    def hide_future(self, task_state: TaskState) -> TaskState:
        """Return the trials without information on the future, for controllers that look ahead.

        By default nothing is hidden. A task that reveals its goals one after the other hides the later ones.
        """
        return task_state

    def potential(self, task_state: TaskState, state: Array) -> Array:
        """Return the potential (B,) of ``state`` (B, nx): below 1 unit of fitness, higher the closer the next gain.

        It guides controllers that look ahead only a few steps. 0 by default.
        """
        return np.zeros(len(state))

    def feasibility_warnings(self, farthest: Array) -> tuple[str, ...]:
        """Return warnings, as sentences, if the bound task is hardly feasible for this robot; none by default.

        ``farthest`` (nx,) is the largest recorded absolute value of each state.
        """
        return ()

    def measures(self, task_state: TaskState) -> Mapping[str, Array]:
        """Return further measures of each trial, (B,) each, by name with the unit in brackets; none by default.

        nan where a trial has no value. The task is bound.
        """
        return {}

    def scene(self, task_state: TaskState, trial: int) -> Scene:
        """Return the scene to draw for one trial, row ``trial`` of ``task_state``; empty by default.

        The task need not be bound.
        """
        return Scene()

    def learn(self, dataset: Dataset) -> LearnedTask:
        """Return the parameters with which this task has learned its reward from ``dataset``; none by default."""
        return LearnedTask({}, ())

    def rewarded_by(self, simulator: str) -> bool:
        """Return whether fitness on the simulator called ``simulator`` is the sum of the simulator's own rewards."""
        return False

    def advance_rewarded(self, task_state: Any, reward: Array) -> TaskState:
        """Return the trials after one step of a simulator with ``reward`` (B,), see `rewarded_by`."""
        raise NotImplementedError

    def raw(self) -> RawInterface | None:
        """Return raw observations and actions of a bound task of an environment, for exported controllers."""
        return None

    def kernel(self) -> TaskKernel[Any] | None:
        """Return the compiled form of a bound task, if it has one."""
        return None


@dataclass(frozen=True)
class LearnedTask:
    """The ``parameters`` that a task has learned from a recording, and ``sentences`` on their held-out errors.

    ``warning`` is a sentence on errors that are too large, else empty. ``exact`` are parameters with which the task
    needs no learning but takes longer; empty if there are none.
    """

    parameters: Mapping[str, str]
    sentences: tuple[str, ...]
    warning: str = ""
    exact: Mapping[str, bool] = field(default_factory=dict)


def learn_task(task: Spec | str, dataset: Dataset) -> Spec:
    """Return the spec of ``task`` with what it learns from ``dataset``, such as the reward of an environment.

    A task that needs no recording is returned as it is. Raises `InvalidData` if the recording has no rewards.
    """
    spec = tasks.check(task)
    made = make_task(spec)
    if not made.needs_recording:
        return spec
    return Spec(spec.name, {**spec.parameters, **made.learn(dataset).parameters}, spec.label)


@dataclass(frozen=True)
class Target:
    """The target of one state: its ``channel``, its index ``place`` among the states, and the target values.

    ``values`` (K,) has one value for each sample, or one for all; errors below ``tolerance`` are accepted.
    """

    channel: Channel
    place: int
    values: Array
    tolerance: float


@dataclass(frozen=True)
class Scene:
    """Places in a trial, in m from the task's origin, and targets of states; empty for a task without any.

    ``markers`` are places (k, 2), or (k, 3) in space, to reach in order, of which the first ``reached`` have been
    reached; ``radius`` is that of each marker, 0 for a point. The trial stays within ``extent`` of the origin, None if
    that is not known. ``walls`` are lines (k, 2), in space paths (k, 3); ``targets`` the targets of states.
    """

    markers: Array = field(default_factory=lambda: np.empty((0, 2)))
    reached: int = 0
    radius: float = 0.0
    extent: float | None = None
    walls: tuple[Array, ...] = ()
    targets: tuple[Target, ...] = ()

    @property
    def next_marker(self) -> Array | None:
        """The first marker that is not reached yet, (2,) m; None if there is none."""
        return self.markers[self.reached] if self.reached < len(self.markers) else None


POSE = ("x", "y", "heading")


def planar_places(task: str, system: System) -> dict[str, int]:
    """Return the indices of the states of a planar body, by role. Raises `IncompatibleTask` without such a body."""
    motion = system.motion
    if motion is None or motion.pose_names != POSE or not {"forward", "yaw_rate"} <= motion.roles().keys():
        raise IncompatibleTask(
            f"{task} needs a planar body (roles forward and yaw_rate); {system.name or 'this system'} has "
            f"{'no motion' if motion is None else motion.kind}"
        )
    return {role: system.state_names.index(name) for role, name in motion.roles().items()}


def make_task(spec: str | Spec, /, **parameters: Any) -> Task:
    """Return the task that ``spec`` names, with its parameters and ``parameters``; see `Registry.make`."""
    made: Task = tasks.make(spec, **parameters)
    return made
