"""A body on a plane, in NumPy."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, final

import numpy as np

from sysid_evo.angles import TURN, wrap
from sysid_evo.arrays import Array
from sysid_evo.motion.contract import Motion
from sysid_evo.registry import register_motion

if TYPE_CHECKING:
    from sysid_evo.motion.compiled_form import MotionKernel
    from sysid_evo.motion.gradient_form import MotionGradient


@final
@register_motion("planar_body")
@dataclass(frozen=True)
class PlanarBody(Motion):
    """A body on a plane: pose x (m), y (m), heading (rad); x forward, y left, counter-clockwise.

    ``forward``, ``lateral`` and ``yaw_rate`` name the state channels with these roles;
    ``lateral`` is None for a system that has no such state.

    Velocities live in the body frame, which turns by a = r_t dt in one sample (paper, footnote 1)::

        [du, dv]_t = R(a) [u, v]_{t+1} - [u, v]_t,    dr_t = r_{t+1} - r_t
        R(a) = [[cos a, -sin a], [sin a, cos a]]

    so that a body which spins while coasting straight has zero acceleration; in continuous time
    w = (r v, -r u, 0). No class may be derived from it, as that would inherit the compiled form of another.
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
        """Return where forward speed, lateral speed (or None) and yaw rate stand among ``names``."""
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

    def turning(self, state: Array, names: Sequence[str]) -> Array:
        forward, lateral, yaw_rate = self.indices(names)
        change = np.zeros_like(state)
        if lateral is not None:
            change[..., forward], change[..., lateral] = frame_change(
                state[..., forward], state[..., lateral], state[..., yaw_rate]
            )
        return change

    def move(self, pose: Array, before: Array, after: Array, dt: float, names: Sequence[str]) -> Array:
        """Return the pose after ``dt``: mean body velocity, turned by the heading half-way (second order).

        The heading comes back in (-pi, pi].
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
        """Return the same for one body: plain numbers take a quarter of the time of arrays with one."""
        forward, lateral, yaw_rate = self.indices(names)
        x, y, heading = pose.tolist()
        mean = [0.5 * (one + other) for one, other in zip(before.tolist(), after.tolist(), strict=True)]
        turned = mean[yaw_rate] * dt
        dx, dy = rotate(mean[forward], 0.0 if lateral is None else mean[lateral], heading + 0.5 * turned)
        turned += heading
        turned -= TURN * round(turned / TURN) if math.isfinite(turned) else math.nan
        return np.array([x + dx * dt, y + dy * dt, turned + TURN if turned <= -0.5 * TURN else turned])

    def velocities(self, pose: Array, rate: Array) -> dict[str, Array]:
        """Return forward speed, lateral speed (m/s) and yaw rate (rad/s): the pose's rate in the body's frame."""
        forward, lateral = rotate(rate[..., 0], rate[..., 1], -pose[..., 2])
        found = {self.forward: forward, self.yaw_rate: rate[..., 2]}
        return found if self.lateral is None else {**found, self.lateral: lateral}

    def seen_from(self, origin: Array, pose: Array) -> Array:
        x, y = rotate(pose[..., 0] - origin[0], pose[..., 1] - origin[1], -origin[2])
        return np.stack([x, y, pose[..., 2] - origin[2]], axis=-1)

    def kernel(self, names: Sequence[str]) -> MotionKernel:
        from sysid_evo.motion.planar_body_kernel import planar_body_kernel

        return planar_body_kernel(*self.indices(names))

    def gradient_form(self, names: Sequence[str]) -> MotionGradient:
        from sysid_evo.motion.planar_body_gradient import PlanarBodyGradient

        return PlanarBodyGradient(*self.indices(names))


def rotate(x: Any, y: Any, angle: Any) -> tuple[Any, Any]:
    """Return the vector (x, y) turned counter-clockwise by ``angle`` in radians: numbers or arrays.

    Sine and cosine come from the tangent t of half the angle, s = 2 t / (1 + t^2) and
    c = 2 / (1 + t^2) - 1: NumPy has vector instructions for it, and none for double sines.
    """
    half = np.tan(0.5 * angle)
    share = 2.0 / (1.0 + half * half)
    return turn(x, y, share - 1.0, share * half)


def turn(x: Any, y: Any, cos: Any, sin: Any) -> tuple[Any, Any]:
    """Return the vector (x, y) turned by the angle with this cosine and sine: numbers, arrays, tensors, lanes."""
    return cos * x - sin * y, sin * x + cos * y


def frame_change(forward: Any, lateral: Any, yaw_rate: Any) -> tuple[Any, Any]:
    """Return how the turning frame changes the two speeds per second: numbers, arrays, tensors, lanes."""
    return yaw_rate * lateral, -yaw_rate * forward
