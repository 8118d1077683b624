"""The motion of a rigid body in space: position and attitude quaternion, body velocities and rates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np

from sysid_evo import angles
from sysid_evo.errors import InvalidSystem
from sysid_evo.kernels import MotionKernel
from sysid_evo.laws import array_form
from sysid_evo.motion import Motion, MotionGradient, Numbers
from sysid_evo.motion_kernels import rigid_body_kernel
from sysid_evo.registry.registry import register_motion
from sysid_evo.types import Array

FRAMES = {"ENU": 1.0, "NED": -1.0}
"""World frames, and the direction of up along their third axis."""

quaternion, product = array_form(angles.quaternion), array_form(angles.product)
unit, rotated = array_form(angles.unit), array_form(angles.rotated)


@final
@register_motion("rigid_body")
@dataclass(frozen=True)
class RigidBody(Motion):
    """A rigid body in space: pose x, y, z (m) and the attitude, a unit quaternion qw, qx, qy, qz from body to world.

    ``frame`` is "ENU" (x east, y north, z up; the body's axes point forward, left, up) or "NED" (x north, y east,
    z down; forward, right, down). The other fields name the state channels: the velocities along the body's axes (m/s),
    the rates about them (rad/s), and the three components of ``up``, the unit vector away from gravity along the body's
    axes: (0, 0, 1) for a level body in ENU, (0, 0, -1) in NED. Gravity acts along it; position and heading
    have no effect on the accelerations, so that they are not among the states.

    With the mean rates a = dt (r_t + r_{t+1}) / 2 of a sample, and R(a) the rotation about the vector a by its length::

        dv_t = R(a) v_{t+1} - v_t,    d up_t = R(a) up_{t+1} - up_t,    dr_t = r_{t+1} - r_t

    In continuous time w = (-r x v, -r x up, 0). An undisturbed ``up`` has no acceleration whatever the rates. The
    attitude is normalised in every step. It must not be subclassed, because a subclass would inherit the wrong
    compiled form. Raises `InvalidSystem` for another frame.

    Source: Solà, Quaternion kinematics for the error-state Kalman filter, 2017, sections 1 and 4.
    """

    kind: ClassVar[str] = "rigid_body"
    n_pose: ClassVar[int] = 7
    pose_names: ClassVar[tuple[str, ...]] = ("x", "y", "z", "qw", "qx", "qy", "qz")
    pose_units: ClassVar[tuple[str, ...]] = ("m", "m", "m", "", "", "", "")

    forward: str = "forward_speed"
    lateral: str = "lateral_speed"
    vertical: str = "vertical_speed"
    roll_rate: str = "roll_rate"
    pitch_rate: str = "pitch_rate"
    yaw_rate: str = "yaw_rate"
    up_x: str = "up_x"
    up_y: str = "up_y"
    up_z: str = "up_z"
    frame: str = "ENU"

    def __post_init__(self) -> None:
        if self.frame not in FRAMES:
            raise InvalidSystem(f"motion rigid_body: expected frame {' or '.join(FRAMES)}, got {self.frame!r}")

    def __init_subclass__(cls, **keywords: Any) -> None:
        raise TypeError(f"{cls.__name__}: no class may be derived from RigidBody; derive it from Motion")

    def roles(self) -> dict[str, str]:
        return {role: getattr(self, role) for role in ROLES}

    def indices(self, names: Sequence[str]) -> tuple[list[int], list[int], list[int]]:
        """Return the indices of the velocities, the rates and the components of up among ``names``."""
        found = [names.index(channel) for channel in self.roles().values()]
        return found[:3], found[3:6], found[6:]

    @property
    def up(self) -> float:
        """The direction of up along the third axis of the world: 1 or -1."""
        return FRAMES[self.frame]

    def initial_pose(self, state: Array, names: Sequence[str]) -> Array:
        """Return the pose in the origin with the attitude of ``state`` and without a turn about the vertical."""
        x, y, z = (self.up * state[..., i] for i in self.indices(names)[2])
        overhead = z < -1.0 + 1e-9
        found = np.zeros((*state.shape[:-1], self.n_pose))
        attitude = unit(np.where(overhead, 0.0, 1.0 + z), np.where(overhead, 1.0, y), np.where(overhead, 0.0, -x), 0.0)
        for i, part in enumerate(attitude):
            found[..., 3 + i] = part
        return found

    def acceleration(self, before: Array, after: Array, dt: float, names: Sequence[str]) -> Array:
        velocities, rates, up = self.indices(names)
        there = np.array(after, dtype=np.float64)
        half = quaternion(*(0.5 * dt * (before[..., i] + after[..., i]) for i in rates))
        for vector in (velocities, up):
            _write(there, vector, rotated(*half, *(after[..., i] for i in vector)))
        return (there - before) / dt

    def integrate(self, state: Array, acceleration: Array, dt: float, names: Sequence[str]) -> Array:
        velocities, rates, up = self.indices(names)
        after = state + acceleration * dt
        back = quaternion(*(-0.5 * dt * (state[..., i] + after[..., i]) for i in rates))
        for vector in (velocities, up):
            _write(after, vector, rotated(*back, *(after[..., i].copy() for i in vector)))
        return after

    def frame_rotation(self, state: Array, names: Sequence[str]) -> Array:
        velocities, rates, up = self.indices(names)
        change = np.zeros_like(state)
        for vector in (velocities, up):
            change[..., vector] = np.cross(state[..., vector], state[..., rates])
        return change

    def move(self, pose: Array, before: Array, after: Array, dt: float, names: Sequence[str]) -> Array:
        """Return the pose after ``dt``: mean body velocity, rotated by the attitude half-way (second order).

        The attitude is exact for constant rates.
        """
        velocities, rates, _ = self.indices(names)
        mean = 0.5 * (before + after)
        half = quaternion(*(0.5 * dt * mean[..., i] for i in rates))
        middle = product(*(pose[..., i] for i in range(3, 7)), *half)
        moved = np.array(pose, dtype=np.float64)
        for i, way in enumerate(rotated(*middle, *(mean[..., j] for j in velocities))):
            moved[..., i] += dt * way
        _write(moved, range(3, 7), unit(*product(*middle, *half)))
        return moved

    def velocities(self, pose: Array, rate: Array) -> dict[str, Array]:
        """Return body velocities (m/s), rates (rad/s) and up from a pose and its change per second."""
        w, x, y, z = (pose[..., i] for i in range(3, 7))
        back = (w, -x, -y, -z)
        turning = product(*back, *(2.0 * rate[..., i] for i in range(3, 7)))[1:]
        zero = np.zeros_like(w)
        found = (
            *rotated(*back, *(rate[..., i] for i in range(3))),
            *turning,
            *rotated(*back, zero, zero, zero + self.up),
        )
        return dict(zip(self.roles().values(), found, strict=True))

    def relative_pose(self, origin: Array, pose: Array) -> Array:
        w, x, y, z = origin[3:]
        back = (w, -x, -y, -z)
        place = rotated(*back, *(pose[..., i] - origin[i] for i in range(3)))
        return np.stack([*place, *product(*back, *(pose[..., i] for i in range(3, 7)))], axis=-1)

    def kernel(self, names: Sequence[str]) -> MotionKernel:
        return rigid_body_kernel(*self.indices(names))

    def gradient_form(self, names: Sequence[str]) -> MotionGradient:
        return RigidBodyGradient(*self.indices(names))


ROLES = ("forward", "lateral", "vertical", "roll_rate", "pitch_rate", "yaw_rate", "up_x", "up_y", "up_z")


def _write(array: Array, places: Sequence[int], values: Sequence[Array]) -> None:
    for place, value in zip(places, values, strict=True):
        array[..., place] = value


@dataclass(frozen=True)
class RigidBodyGradient:
    """Derivatives of `RigidBody`, with its vectors in the given columns of the state.

    For y = R(-a) b and the gradient g by y, the gradient by b is R(a) g, and that by a is -J(a) (y x g) with the
    left Jacobian J(a) w = w + (1 - cos t) / t^2 a x w + (t - sin t) / t^3 a x (a x w), t = |a| (Solà, equation 183).
    """

    speeds: list[int]
    rates: list[int]
    up: list[int]

    def of_integrate(
        self, state: Numbers, acceleration: Numbers, dt: float, gradient: Numbers
    ) -> tuple[Numbers, Numbers]:
        before = state + dt * acceleration
        turned = 0.5 * dt * (state[..., self.rates] + before[..., self.rates])
        forth = quaternion(*np.moveaxis(turned, -1, 0))
        w, x, y, z = forth
        by_before, torque = gradient.copy(), np.zeros_like(turned)
        for vector in (self.speeds, self.up):
            given = gradient[..., vector]
            by_before[..., vector] = np.stack(rotated(*forth, *np.moveaxis(given, -1, 0)), axis=-1)
            after = np.stack(rotated(w, -x, -y, -z, *np.moveaxis(before[..., vector], -1, 0)), axis=-1)
            torque += np.cross(after, given)
        by_turned = -left_jacobian(turned, torque)
        by_state, by_acceleration = by_before.copy(), dt * by_before
        by_state[..., self.rates] += dt * by_turned
        by_acceleration[..., self.rates] += 0.5 * dt * dt * by_turned
        return by_state, by_acceleration

    def of_frame_rotation(self, state: Numbers, gradient: Numbers) -> Numbers:
        found = np.zeros_like(state)
        for vector in (self.speeds, self.up):
            found[..., vector] = np.cross(state[..., self.rates], gradient[..., vector])
            found[..., self.rates] += np.cross(gradient[..., vector], state[..., vector])
        return found


SERIES = 1e-2
"""Angle (rad) below which (t - sin t) / t^3 is computed from its series."""


def left_jacobian(turned: Numbers, vector: Numbers) -> Numbers:
    """Return J(a) w for rotation vectors ``turned`` (..., 3) and a ``vector`` (..., 3), see `RigidBodyGradient`."""
    square = np.sum(turned * turned, axis=-1, keepdims=True)
    angle = np.sqrt(square + angles.SMALLEST)
    first = 2.0 * (np.sin(0.5 * angle) / angle) ** 2
    long = np.maximum(angle, SERIES)
    second = np.where(angle < SERIES, 1.0 / 6.0 - square / 120.0, (long - np.sin(long)) / long**3)
    once = np.cross(turned, vector)
    return vector + first * once + second * np.cross(turned, once)
