"""How states move a pose: the only place that knows about frames and their rotation."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, ClassVar

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.errors import InvalidSystem


class Motion(ABC):
    """Names the state channels that move a pose, by role."""

    kind: ClassVar[str]
    n_pose: ClassVar[int]
    pose_names: ClassVar[tuple[str, ...]]
    pose_units: ClassVar[tuple[str, ...]]

    @abstractmethod
    def roles(self) -> dict[str, str]:
        """Return the channel of each role that this motion has."""

    @abstractmethod
    def acceleration(self, before: Array, after: Array, dt: float, names: Sequence[str]) -> Array:
        """Return the change per second with the frame's own rotation taken out, (..., nx)."""

    @abstractmethod
    def integrate(self, state: Array, acceleration: Array, dt: float, names: Sequence[str]) -> Array:
        """Return the state ``dt`` later: the exact inverse of `acceleration`."""

    @abstractmethod
    def move(self, pose: Array, before: Array, after: Array, dt: float, names: Sequence[str]) -> Array:
        """Return the pose (..., n_pose) after ``dt``, given the states at both ends (..., nx)."""

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
        return {"kind": self.kind, **asdict(self)}  # type: ignore[call-overload]  # concrete motions are dataclasses


@dataclass(frozen=True)
class PlanarBody(Motion):
    """A body on a plane: pose x (m), y (m), heading (rad); x forward, y left, counter-clockwise.

    ``forward``, ``lateral`` and ``yaw_rate`` name the state channels with these roles;
    ``lateral`` is None for a system that has no such state.

    Velocities live in the body frame, which turns by a = r_t dt in one sample (paper, footnote 1)::

        [du, dv]_t = R(a) [u, v]_{t+1} - [u, v]_t,    dr_t = r_{t+1} - r_t
        R(a) = [[cos a, -sin a], [sin a, cos a]]

    so that a body which spins while coasting straight has zero acceleration.
    """

    kind: ClassVar[str] = "planar_body"
    n_pose: ClassVar[int] = 3
    pose_names: ClassVar[tuple[str, ...]] = ("x", "y", "heading")
    pose_units: ClassVar[tuple[str, ...]] = ("m", "m", "rad")

    forward: str = "forward_speed"
    lateral: str | None = "lateral_speed"
    yaw_rate: str = "yaw_rate"

    def roles(self) -> dict[str, str]:
        roles = {"forward": self.forward, "yaw_rate": self.yaw_rate}
        return roles if self.lateral is None else {**roles, "lateral": self.lateral}

    def indices(self, names: Sequence[str]) -> tuple[int, int | None, int]:
        """Return where forward speed, lateral speed (or None) and yaw rate stand among ``names``."""
        lateral = None if self.lateral is None else names.index(self.lateral)
        return names.index(self.forward), lateral, names.index(self.yaw_rate)

    def acceleration(self, before: Array, after: Array, dt: float, names: Sequence[str]) -> Array:
        forward, lateral, yaw_rate = self.indices(names)
        turned = np.array(after, dtype=np.float64)
        if lateral is not None:
            turned[..., forward], turned[..., lateral] = rotate(
                after[..., forward], after[..., lateral], before[..., yaw_rate] * dt
            )
        return (turned - before) / dt

    def integrate(self, state: Array, acceleration: Array, dt: float, names: Sequence[str]) -> Array:
        forward, lateral, yaw_rate = self.indices(names)
        after = state + acceleration * dt
        if lateral is not None:
            after[..., forward], after[..., lateral] = rotate(
                after[..., forward], after[..., lateral], -state[..., yaw_rate] * dt
            )
        return after

    def move(self, pose: Array, before: Array, after: Array, dt: float, names: Sequence[str]) -> Array:
        """Return the pose after ``dt``: mean body velocity, turned by the heading half-way (second order)."""
        forward, lateral, yaw_rate = self.indices(names)
        mean = before + after
        mean *= 0.5
        turn = mean[..., yaw_rate] * dt
        along = mean[..., forward]
        across = np.zeros_like(along) if lateral is None else mean[..., lateral]
        dx, dy = rotate(along, across, pose[..., 2] + 0.5 * turn)
        moved = np.array(pose)
        moved[..., 0] += dx * dt
        moved[..., 1] += dy * dt
        moved[..., 2] += turn
        return moved


def rotate(x: Array, y: Array, angle: Array) -> tuple[Array, Array]:
    """Return the vector (x, y) turned counter-clockwise by ``angle`` in radians.

    Sine and cosine come from the tangent t of half the angle, s = 2 t / (1 + t^2) and
    c = 2 / (1 + t^2) - 1: NumPy has vector instructions for it, and none for double sines.
    """
    half = np.tan(0.5 * angle)
    share = 2.0 / (1.0 + half * half)
    cos, sin = share - 1.0, share * half
    return cos * x - sin * y, sin * x + cos * y


def seen_from(origin: Array, pose: Array) -> Array:
    """Return a planar ``pose`` (..., 3) in the frame of ``origin`` (3,); headings are not wrapped."""
    x, y = rotate(pose[..., 0] - origin[0], pose[..., 1] - origin[1], -origin[2])
    return np.stack([x, y, pose[..., 2] - origin[2]], axis=-1)


MOTIONS: dict[str, Callable[..., Motion]] = {PlanarBody.kind: PlanarBody}


def motion_from_dict(value: Mapping[str, Any]) -> Motion:
    """Undo `Motion.to_dict`."""
    arguments = dict(value)
    kind = arguments.pop("kind", None)
    if kind not in MOTIONS:
        raise InvalidSystem(f"motion: expected one of {', '.join(MOTIONS)}, got {kind!r}")
    return MOTIONS[kind](**arguments)
