"""One episode of a system: states, the controls held between them, and where the body was."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid_evo.arrays import Array, check_shape
from sysid_evo.errors import InvalidData


@dataclass(frozen=True)
class Trajectory:
    """One episode of T steps.

    ``states`` is (T + 1, nx), ``controls`` (T, nu): ``controls[k]`` is held from k dt to (k + 1) dt
    and takes ``states[k]`` to ``states[k + 1]``. ``dt`` is in seconds. ``pose`` is (T + 1, n_pose)
    in the units of the system's motion, or None. ``condition`` names the day, floor or battery it was recorded
    with, if somebody said so. A single state or control may be 1-D. Raises
    `ShapeError` or `InvalidData`.
    """

    states: Array
    controls: Array
    dt: float
    pose: Array | None = None
    name: str = ""
    condition: str = ""

    def __post_init__(self) -> None:
        states = check_shape(f"states of {self.name!r}", as_columns(self.states), (None, None))
        controls = check_shape(f"controls of {self.name!r}", as_columns(self.controls), (len(states) - 1, None))
        object.__setattr__(self, "states", states)
        object.__setattr__(self, "controls", controls)
        if self.pose is not None:
            object.__setattr__(self, "pose", check_shape(f"pose of {self.name!r}", self.pose, (len(states), None)))
        if len(controls) < 1:
            raise InvalidData(f"episode {self.name!r}: expected at least one step, got {len(states)} sample(s)")
        for what, array in (("state", states), ("control", controls), ("pose", self.pose)):
            if array is not None and not np.isfinite(array).all():
                row, column = np.argwhere(~np.isfinite(array))[0]
                raise InvalidData(f"episode {self.name!r}: {what} {column} at sample {row} is {array[row, column]}")

    def __len__(self) -> int:
        """Return the number of steps, T."""
        return len(self.controls)

    @property
    def duration(self) -> float:
        """Length in seconds."""
        return len(self) * self.dt

    def __getitem__(self, steps: slice) -> Trajectory:
        """Return the episode of a range of steps, with the state at its end."""
        if not isinstance(steps, slice) or steps.step not in (None, 1):
            raise InvalidData("episode: expected a plain range of steps, like episode[10:50]")
        first, last, _ = steps.indices(len(self))
        return Trajectory(
            states=self.states[first : last + 1],
            controls=self.controls[first:last],
            dt=self.dt,
            pose=None if self.pose is None else self.pose[first : last + 1],
            name=f"{self.name}[{first}:{last}]",
            condition=self.condition,
        )


def as_columns(values: npt.ArrayLike) -> npt.ArrayLike:
    """Return 1-D ``values``, those of a single channel, as one column; anything else as it is."""
    return np.asarray(values)[:, None] if np.ndim(values) == 1 else values
