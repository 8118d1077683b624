"""Motions, which turn states into poses and handle turning frames; the body on a plane."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, ClassVar, Protocol, TypeAlias, final

import numpy as np
import numpy.typing as npt

from sysid_evo.angles import TURN, frame_change, rotate, turn, wrap
from sysid_evo.errors import IncompatibleSystem, InvalidSystem, UnknownName
from sysid_evo.kernels import MotionKernel
from sysid_evo.motion_kernels import planar_body_kernel
from sysid_evo.registry.registry import motions, register_motion
from sysid_evo.types import Array

Numbers: TypeAlias = npt.NDArray[Any]
"""Arrays of single or double precision."""
SMALL_STEP = 1e-6
"""Step of `CentralDifferences`."""


class MotionGradient(Protocol):
    """Backpropagation: from the ``gradient`` by a result (..., nx) to the gradients by its arguments."""

    def of_integrate(
        self, state: Numbers, acceleration: Numbers, dt: float, gradient: Numbers
    ) -> tuple[Numbers, Numbers]:
        """Return the gradients by state and by acceleration for `Motion.integrate`."""

    def of_frame_rotation(self, state: Numbers, gradient: Numbers) -> Numbers:
        """Return the gradient by the state for `Motion.frame_rotation`."""


class Motion(ABC):
    """Base class of motions: the roles of state channels, and the equations of the pose and the turning frame.

    A motion is a frozen dataclass of channel names, registered under its ``kind``. Subclasses define `roles`,
    `acceleration`, `integrate`, `frame_rotation` and `move`; all take states (..., nx) and the ``names`` of their
    channels. `kernel` is the compiled form; without it systems with this motion run in NumPy. `gradient_form` is the
    derivative, by default by finite differences. `velocities` and `relative_pose` are only needed for measured poses,
    in the preparation of logs and for robots.
    """

    kind: ClassVar[str]
    n_pose: ClassVar[int]
    pose_names: ClassVar[tuple[str, ...]]
    pose_units: ClassVar[tuple[str, ...]]

    @abstractmethod
    def roles(self) -> dict[str, str]:
        """Return the channel of each role that this motion has."""

    @abstractmethod
    def acceleration(self, before: Array, after: Array, dt: float, names: Sequence[str]) -> Array:
        """Return the change per second without the rotation of the frame, (..., nx)."""

    @abstractmethod
    def integrate(self, state: Array, acceleration: Array, dt: float, names: Sequence[str]) -> Array:
        """Return the state ``dt`` later: the exact inverse of `acceleration`."""

    @abstractmethod
    def frame_rotation(self, state: Array, names: Sequence[str]) -> Array:
        """Return w(x) in dx/dt = acceleration + w(x), the effect of the turning frame."""

    @abstractmethod
    def move(self, pose: Array, before: Array, after: Array, dt: float, names: Sequence[str]) -> Array:
        """Return the pose (..., n_pose) after ``dt``, given the states at both ends (..., nx)."""

    def initial_pose(self, state: Array, names: Sequence[str]) -> Array:
        """Return the pose (..., n_pose) in the origin of a body with this ``state`` (..., nx); zeros by default."""
        return np.zeros((*np.shape(state)[:-1], self.n_pose))

    def velocities(self, pose: Array, rate: Array) -> dict[str, Array]:
        """Return the values of each role (...,) from a pose (..., n_pose) and its change per second.

        Raises `IncompatibleSystem` if this motion does not define it.
        """
        raise IncompatibleSystem(f"motion {self.kind} does not define the velocities of a moving pose")

    def relative_pose(self, origin: Array, pose: Array) -> Array:
        """Return a pose (..., n_pose) in the frame of ``origin`` (n_pose,); angles are not wrapped.

        Raises `IncompatibleSystem` if this motion does not define it.
        """
        raise IncompatibleSystem(f"motion {self.kind} does not define relative poses")

    def kernel(self, names: Sequence[str]) -> MotionKernel | None:
        """Return the compiled form for states with these ``names``, if it has one."""
        return None

    def gradient_form(self, names: Sequence[str]) -> MotionGradient:
        """Return the derivatives for states with these ``names``; by default finite differences."""
        return CentralDifferences(self, tuple(names))

    def check(self, names: Sequence[str]) -> None:
        """Raise `InvalidSystem` if a role names a channel that is not among ``names``."""
        for role, channel in self.roles().items():
            if channel not in names:
                raise InvalidSystem(
                    f"motion {self.kind}: role {role!r} names the channel {channel!r}, "
                    f"but the states are {', '.join(names)}"
                )

    def to_dict(self) -> dict[str, Any]:
        """Return the motion as strict JSON."""
        motion: Any = self  # every concrete subclass is a dataclass
        return {"kind": self.kind, **asdict(motion)}


def motion_from_dict(value: Mapping[str, Any]) -> Motion:
    """Undo `Motion.to_dict`. Raises `InvalidSystem` for an unknown kind, or for other roles than it has."""
    arguments = dict(value)
    kind = arguments.pop("kind", None)
    try:
        make = motions.get(str(kind))
    except UnknownName as error:
        raise InvalidSystem(
            f"motion: expected one of {', '.join(motions.names())}, got {kind!r}. "
            "A motion in your own file is loaded with --plugin FILE."
        ) from error
    try:
        return make(**arguments)
    except TypeError as error:
        raise InvalidSystem(
            f"motion {kind}: cannot be made from {', '.join(arguments) or 'nothing'}: {error}"
        ) from error


@dataclass(frozen=True)
class CentralDifferences:
    """Derivatives of any motion by central differences in double precision."""

    motion: Motion
    names: Sequence[str]

    def of_integrate(
        self, state: Numbers, acceleration: Numbers, dt: float, gradient: Numbers
    ) -> tuple[Numbers, Numbers]:
        by_state = vector_jacobian(lambda x: self.motion.integrate(x, acceleration, dt, self.names), state, gradient)
        return by_state, vector_jacobian(
            lambda a: self.motion.integrate(state, a, dt, self.names), acceleration, gradient
        )

    def of_frame_rotation(self, state: Numbers, gradient: Numbers) -> Numbers:
        return vector_jacobian(lambda x: self.motion.frame_rotation(x, self.names), state, gradient)


def vector_jacobian(function: Callable[[Numbers], Numbers], at: Numbers, gradient: Numbers) -> Numbers:
    """Return the gradient by ``at`` (..., n) from the ``gradient`` by ``function(at)``, by central differences."""
    at, found = np.asarray(at, dtype=np.float64), np.empty(at.shape)
    for column in range(at.shape[-1]):
        step = np.zeros(at.shape[-1])
        step[column] = SMALL_STEP
        slope = (function(at + step) - function(at - step)) / (2.0 * SMALL_STEP)
        found[..., column] = np.sum(slope * gradient, axis=-1)
    return found


class StraightGradient:
    """Derivatives for a system without a motion, which has no turning frame."""

    def of_integrate(
        self, state: Numbers, acceleration: Numbers, dt: float, gradient: Numbers
    ) -> tuple[Numbers, Numbers]:
        return gradient, dt * gradient

    def of_frame_rotation(self, state: Numbers, gradient: Numbers) -> Numbers:
        return np.zeros_like(state)


@final
@register_motion("planar_body")
@dataclass(frozen=True)
class PlanarBody(Motion):
    """A body on a plane: pose x (m), y (m), heading (rad); x forward, y left, counter-clockwise.

    ``forward``, ``lateral`` and ``yaw_rate`` name the state channels with these roles;
    ``lateral`` is None for a system without such a state.

    Velocities are in the body frame, which turns by a = r_t dt in one sample (paper, footnote 1)::

        [du, dv]_t = R(a) [u, v]_{t+1} - [u, v]_t,    dr_t = r_{t+1} - r_t
        R(a) = [[cos a, -sin a], [sin a, cos a]]

    so that a body which spins while coasting straight has zero acceleration; in continuous time
    w = (r v, -r u, 0). It must not be subclassed, because a subclass would inherit the wrong compiled form.
    """

    kind: ClassVar[str] = "planar_body"
    n_pose: ClassVar[int] = 3
    pose_names: ClassVar[tuple[str, ...]] = ("x", "y", "heading")
    pose_units: ClassVar[tuple[str, ...]] = ("m", "m", "rad")

    forward: str = "forward_speed"
    lateral: str | None = "lateral_speed"
    yaw_rate: str = "yaw_rate"

    def __init_subclass__(cls, **keywords: Any) -> None:
        raise TypeError(f"{cls.__name__}: no class may be derived from PlanarBody; derive it from Motion")

    def roles(self) -> dict[str, str]:
        roles = {"forward": self.forward, "yaw_rate": self.yaw_rate}
        return roles if self.lateral is None else {**roles, "lateral": self.lateral}

    def indices(self, names: Sequence[str]) -> tuple[int, int | None, int]:
        """Return the indices of forward speed, lateral speed (or None) and yaw rate among ``names``."""
        lateral = None if self.lateral is None else names.index(self.lateral)
        return names.index(self.forward), lateral, names.index(self.yaw_rate)

    def acceleration(self, before: Array, after: Array, dt: float, names: Sequence[str]) -> Array:
        forward, lateral, yaw_rate = self.indices(names)
        there = np.array(after, dtype=np.float64)
        if lateral is not None:
            there[..., forward], there[..., lateral] = rotate(
                after[..., forward], after[..., lateral], before[..., yaw_rate] * dt
            )
        return (there - before) / dt

    def integrate(self, state: Array, acceleration: Array, dt: float, names: Sequence[str]) -> Array:
        forward, lateral, yaw_rate = self.indices(names)
        after = state + acceleration * dt
        if lateral is not None:
            after[..., forward], after[..., lateral] = rotate(
                after[..., forward], after[..., lateral], -state[..., yaw_rate] * dt
            )
        return after

    def frame_rotation(self, state: Array, names: Sequence[str]) -> Array:
        forward, lateral, yaw_rate = self.indices(names)
        change = np.zeros_like(state)
        if lateral is not None:
            change[..., forward], change[..., lateral] = frame_change(
                state[..., forward], state[..., lateral], state[..., yaw_rate]
            )
        return change

    def move(self, pose: Array, before: Array, after: Array, dt: float, names: Sequence[str]) -> Array:
        """Return the pose after ``dt``: mean body velocity, rotated by the heading half-way (second order).

        The heading is in (-pi, pi].
        """
        if pose.ndim == 1:
            return self._move_one(pose, before, after, dt, names)
        forward, lateral, yaw_rate = self.indices(names)
        mean = before + after
        mean *= 0.5
        turned = mean[..., yaw_rate] * dt
        along = mean[..., forward]
        across = np.zeros_like(along) if lateral is None else mean[..., lateral]
        dx, dy = rotate(along, across, pose[..., 2] + 0.5 * turned)
        moved = np.array(pose)
        moved[..., 0] += dx * dt
        moved[..., 1] += dy * dt
        moved[..., 2] = wrap(moved[..., 2] + turned)
        return moved

    def _move_one(self, pose: Array, before: Array, after: Array, dt: float, names: Sequence[str]) -> Array:
        """Return the same for one body with plain numbers, which is four times as fast as arrays of size one."""
        forward, lateral, yaw_rate = self.indices(names)
        x, y, heading = pose.tolist()
        mean = [0.5 * (one + other) for one, other in zip(before.tolist(), after.tolist(), strict=True)]
        turned = mean[yaw_rate] * dt
        dx, dy = rotate(mean[forward], 0.0 if lateral is None else mean[lateral], heading + 0.5 * turned)
        turned += heading
        turned -= TURN * round(turned / TURN) if math.isfinite(turned) else math.nan
        return np.array([x + dx * dt, y + dy * dt, turned + TURN if turned <= -0.5 * TURN else turned])

    def velocities(self, pose: Array, rate: Array) -> dict[str, Array]:
        """Return forward speed, lateral speed (m/s) and yaw rate (rad/s): the rate of the pose in the body frame."""
        forward, lateral = rotate(rate[..., 0], rate[..., 1], -pose[..., 2])
        found = {self.forward: forward, self.yaw_rate: rate[..., 2]}
        return found if self.lateral is None else {**found, self.lateral: lateral}

    def relative_pose(self, origin: Array, pose: Array) -> Array:
        x, y = rotate(pose[..., 0] - origin[0], pose[..., 1] - origin[1], -origin[2])
        return np.stack([x, y, pose[..., 2] - origin[2]], axis=-1)

    def kernel(self, names: Sequence[str]) -> MotionKernel:
        return planar_body_kernel(*self.indices(names))

    def gradient_form(self, names: Sequence[str]) -> MotionGradient:
        return PlanarBodyGradient(*self.indices(names))


@dataclass(frozen=True)
class PlanarBodyGradient:
    """Derivatives of `PlanarBody`, with its roles in the given columns of the state.

    A velocity w rotated by the angle a is R(a) w. From the gradient g by R(a) w follow the gradient by w,
    h = R(a)^T g, and that by a, w x h.
    """

    forward: int
    lateral: int | None
    yaw_rate: int

    def of_integrate(
        self, state: Numbers, acceleration: Numbers, dt: float, gradient: Numbers
    ) -> tuple[Numbers, Numbers]:
        by_state = gradient.copy()
        if self.lateral is None:
            return by_state, dt * gradient
        angle = state[..., self.yaw_rate] * dt
        along, across = turn(gradient[..., self.forward], gradient[..., self.lateral], np.cos(angle), np.sin(angle))
        by_state[..., self.forward], by_state[..., self.lateral] = along, across
        by_acceleration = dt * by_state
        before = state + acceleration * dt
        by_state[..., self.yaw_rate] -= dt * (before[..., self.forward] * across - before[..., self.lateral] * along)
        return by_state, by_acceleration

    def of_frame_rotation(self, state: Numbers, gradient: Numbers) -> Numbers:
        found = np.zeros_like(state)
        if self.lateral is not None:
            along, across = gradient[..., self.forward], gradient[..., self.lateral]
            yaw_rate = state[..., self.yaw_rate]
            found[..., self.forward], found[..., self.lateral] = -yaw_rate * across, yaw_rate * along
            found[..., self.yaw_rate] = state[..., self.lateral] * along - state[..., self.forward] * across
        return found
