"""The contract of a motion: how states move a pose, and what the turning of their frame does to velocities."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, ClassVar

from sysid_evo.arrays import Array
from sysid_evo.errors import IncompatibleSystem, InvalidSystem, UnknownName
from sysid_evo.registry import motions

if TYPE_CHECKING:
    from sysid_evo.motion.compiled_form import MotionKernel
    from sysid_evo.motion.gradient_form import MotionGradient


class Motion(ABC):
    """Names the state channels that move a pose, by role, and is the only one that turns them.

    A motion is a frozen dataclass of channel names, registered under its ``kind``. Five methods are
    wanted: `roles`, `acceleration`, `integrate`, `turning`, `move`; all take states (..., nx) and the
    ``names`` of their channels. `kernel` is the same in compiled arithmetic: without it systems with
    this motion run in NumPy. `gradient_form` is the derivative: by default it is taken by differences.
    `velocities` and `seen_from` are wanted only by what works with measured poses: preparation of
    logs, and robots.
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
        """Return the change per second with the frame's own rotation taken out, (..., nx)."""

    @abstractmethod
    def integrate(self, state: Array, acceleration: Array, dt: float, names: Sequence[str]) -> Array:
        """Return the state ``dt`` later: the exact inverse of `acceleration`."""

    @abstractmethod
    def turning(self, state: Array, names: Sequence[str]) -> Array:
        """Return w(x) in dx/dt = acceleration + w(x): how the turning frame changes the state, per second."""

    @abstractmethod
    def move(self, pose: Array, before: Array, after: Array, dt: float, names: Sequence[str]) -> Array:
        """Return the pose (..., n_pose) after ``dt``, given the states at both ends (..., nx)."""

    def velocities(self, pose: Array, rate: Array) -> dict[str, Array]:
        """Return the channel of each role (...,) from a pose (..., n_pose) and its change per second.

        Raises `IncompatibleSystem` if this motion does not say so.
        """
        raise IncompatibleSystem(f"motion {self.kind} does not say which velocities a moving pose means")

    def seen_from(self, origin: Array, pose: Array) -> Array:
        """Return a pose (..., n_pose) in the frame of ``origin`` (n_pose,); angles are not wrapped.

        Raises `IncompatibleSystem` if this motion does not say so.
        """
        raise IncompatibleSystem(f"motion {self.kind} does not say how one pose is seen from another")

    def kernel(self, names: Sequence[str]) -> MotionKernel | None:
        """Return the compiled form for states with these ``names``, if it has one."""
        return None

    def gradient_form(self, names: Sequence[str]) -> MotionGradient:
        """Return the derivatives for states with these ``names``; by default those by differences."""
        from sysid_evo.motion.gradient_form import CentralDifferences

        return CentralDifferences(self, tuple(names))

    @property
    def angles(self) -> tuple[int, ...]:
        """Which coordinates of the pose are angles in rad."""
        return tuple(i for i, unit in enumerate(self.pose_units) if unit == "rad")

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
        motion: Any = self  # every one that is not abstract is a dataclass
        return {"kind": self.kind, **asdict(motion)}


def motion_from_dict(value: Mapping[str, Any]) -> Motion:
    """Undo `Motion.to_dict`. Raises `InvalidSystem` for a kind that is not known, or for other roles than it has."""
    arguments = dict(value)
    kind = arguments.pop("kind", None)
    try:
        make = motions.get(str(kind))
    except UnknownName as error:
        raise InvalidSystem(
            f"motion: expected one of {', '.join(motions.names())}, got {kind!r}. "
            "A motion in a file of its own is loaded with --plugin FILE."
        ) from error
    try:
        return make(**arguments)
    except TypeError as error:
        raise InvalidSystem(
            f"motion {kind}: cannot be made from {', '.join(arguments) or 'nothing'}: {error}"
        ) from error
