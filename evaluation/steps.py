"""Single steps of trajectories: state, control, next state, and how long the control has been held."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from sysid_evo.data import Dataset, Trajectory
from sysid_evo.data.support import Support
from sysid_evo.data.trajectory import evenly_spaced
from sysid_evo.errors import InvalidData
from sysid_evo.motion import PlanarBody
from sysid_evo.system import System
from sysid_evo.types import Array, BoolArray, IntArray


@dataclass(frozen=True)
class Steps:
    """N steps of ``system``: ``control`` (N, nu) led from ``before`` to ``after``, (N, nx) each.

    ``held`` (N,) is the number of steps with the same command up to this one: 1 is the first of a new command, 0 one
    before the first change. ``previous`` (N,) is the number of steps with the command before it, counted from the start
    of the run for its first command. ``jump`` (N, nx) is the acceleration minus that of the step before, 0 if there is
    none. All are 0 for steps without their past.
    """

    system: System
    before: Array
    control: Array
    after: Array
    held: IntArray = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    previous: IntArray = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    jump: Array = field(default_factory=lambda: np.empty(0))

    def __post_init__(self) -> None:
        if len(self.held) != len(self.before):
            object.__setattr__(self, "held", np.zeros(len(self.before), dtype=np.int64))
            object.__setattr__(self, "previous", np.zeros(len(self.before), dtype=np.int64))
            object.__setattr__(self, "jump", np.zeros_like(self.before))

    def __len__(self) -> int:
        return len(self.before)

    @classmethod
    def of(cls, system: System, trajectories: Iterable[Trajectory]) -> Steps:
        """Return every step of ``trajectories``."""
        all_of = list(trajectories)
        none_x, none_u = np.empty((0, system.nx)), np.empty((0, system.nu))
        none, counted = np.empty(0, dtype=np.int64), [_counted(t.controls) for t in all_of]
        rates = [system.acceleration(t.states[:-1], t.states[1:]) for t in all_of]
        return cls(
            system,
            np.concatenate([none_x, *(t.states[:-1] for t in all_of)]),
            np.concatenate([none_u, *(t.controls for t in all_of)]),
            np.concatenate([none_x, *(t.states[1:] for t in all_of)]),
            np.concatenate([none, *(held for held, _ in counted)]),
            np.concatenate([none, *(previous for _, previous in counted)]),
            np.concatenate([none_x, *(np.diff(rate, axis=0, prepend=rate[:1]) for rate in rates)]),
        )

    def thinned(self, most: int) -> Steps:
        """Return at most ``most`` of them, evenly spread."""
        return self if len(self) <= most else self[evenly_spaced(len(self), most, nearest=True)]

    @classmethod
    def moving(cls, dataset: Dataset) -> Steps:
        """Return the steps of ``dataset`` that start in motion. Raises `InvalidData` if none does."""
        return cls.of(dataset.system, dataset.episodes)[cls.rows_moving(dataset)]

    def __getitem__(self, rows: BoolArray | IntArray | slice) -> Steps:
        """Return some of the steps."""
        return replace(
            self,
            before=self.before[rows],
            control=self.control[rows],
            after=self.after[rows],
            held=self.held[rows],
            previous=self.previous[rows],
            jump=self.jump[rows],
        )

    @staticmethod
    def rows_moving(dataset: Dataset) -> BoolArray:
        """Return which steps of ``dataset`` (N,) start in motion. Raises `InvalidData` if none does."""
        rows = np.concatenate([moving[:-1] for moving in dataset.moving])
        if not rows.any():
            raise InvalidData("data set: expected steps in motion, but nothing moves in it")
        return rows

    @cached_property
    def idle(self) -> BoolArray:
        """Whether the command of each step is neutral, (N,)."""
        return np.asarray((self.control == self.system.neutral_control).all(axis=1))

    @cached_property
    def off_neutral(self) -> Array:
        """Difference of each state from neutral, (N, nx), the shortest way round for periodic states."""
        return self.system.difference(self.before, np.broadcast_to(self.system.neutral_state, self.before.shape))

    @cached_property
    def acceleration(self) -> Array:
        """Change of each state per second, (N, nx), without the rotation of the frame."""
        return self.system.acceleration(self.before, self.after)

    @property
    def pairs(self) -> Array:
        """State and control of each step, (N, n + nu), with sine and cosine of periodic states."""
        return np.concatenate([self.system.regressors(self.before), self.control], axis=1)

    def distances(self, support: Support) -> Array:
        """Return the distance (N,) of each step to the nearest one of the training data, in standard deviations."""
        return support.distances(self.before, self.control)

    def share_outside(self, support: Support) -> float | None:
        """Return the share of steps outside the training data, None without any."""
        return float((self.distances(support) > support.limit).mean()) if len(self) else None

    @cached_property
    def planar(self) -> PlanarSteps:
        """The steps by role. Raises `InvalidData` unless the system is a planar body."""
        motion = self.system.motion
        if not isinstance(motion, PlanarBody):
            raise InvalidData(f"expected the steps of a planar body, which {self.system.name or 'this system'} is not")
        forward, lateral, yaw_rate = motion.indices(self.system.state_names)
        change, zero = self.acceleration, np.zeros(len(self))
        return PlanarSteps(
            forward_speed=self.before[:, forward],
            lateral_speed=zero if lateral is None else self.before[:, lateral],
            yaw_rate=self.before[:, yaw_rate],
            forward_acceleration=change[:, forward],
            lateral_acceleration=zero if lateral is None else change[:, lateral],
            yaw_acceleration=change[:, yaw_rate],
            held=self.held,
            idle=self.idle,
        )


def _counted(controls: Array) -> tuple[IntArray, IntArray]:
    """Return for how many steps each of the commands (T, nu) of a run has been held, and the one before it.

    Both are 0 until the first change.
    """
    index = np.arange(len(controls))
    changes = np.flatnonzero((controls[1:] != controls[:-1]).any(axis=1)) + 1
    number = np.searchsorted(changes, index, side="right")
    begins = np.concatenate([[0, 0], changes])
    known = number > 0
    begun, before = begins[number + 1], begins[number]
    return np.where(known, index - begun + 1, 0), np.where(known, begun - before, 0)


@dataclass(frozen=True)
class PlanarSteps:
    """N steps of a planar body by role, (N,) each, at their start; speeds in m/s and rad/s.

    A system without lateral speed has zeros. Accelerations (m/s^2, rad/s^2) are without the rotation of the body
    frame. ``held`` and ``idle`` are those of `Steps`.
    """

    forward_speed: Array
    lateral_speed: Array
    yaw_rate: Array
    forward_acceleration: Array
    lateral_acceleration: Array
    yaw_acceleration: Array
    held: IntArray
    idle: BoolArray

    @property
    def all(self) -> BoolArray:
        """A mask of every step."""
        return np.ones(len(self.forward_speed), dtype=bool)


def training_support(training: Dataset) -> Support:
    """Return the region of the steps of ``training``; scale and limit are those of its steps in motion.

    By definition 1 % of them are outside, each left out in turn. Neighbours in time make the limit a tight one, so
    compare shares with that of held-out data. Raises `InvalidData` with fewer than two steps, or if nothing moves.
    """
    steps = Steps.of(training.system, training.episodes)
    if len(steps) < 2:
        raise InvalidData(f"support: expected two or more training pairs, got {len(steps)}")
    return Support.of(training.system, steps.before, steps.control, moving=Steps.rows_moving(training))
