"""A log as a recorder writes it: poses and commands on the tracker's clock, not yet a data set."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from sysid_evo.arrays import Array, BoolArray, check_shape
from sysid_evo.errors import ShapeError


@dataclass(frozen=True)
class RawLog:
    """N rows of one recording, before preparation.

    ``time`` (N,) in s; ``pose`` (N, n_pose) in the units of the system's motion; ``controls``
    (N, nu): the command in force from this row on; ``extra``: other columns (N,), by name; ``condition``: the name of
    the condition in which each row was recorded (N,), or None.
    """

    name: str
    time: Array
    pose: Array
    controls: Array
    extra: Mapping[str, Array] = field(default_factory=dict)
    condition: npt.NDArray[np.str_] | None = None

    def __post_init__(self) -> None:
        time = check_shape(f"time of {self.name!r}", self.time, (None,))
        object.__setattr__(self, "time", time)
        object.__setattr__(self, "pose", check_shape(f"pose of {self.name!r}", self.pose, (len(time), None)))
        object.__setattr__(
            self, "controls", check_shape(f"controls of {self.name!r}", self.controls, (len(time), None))
        )
        for name, column in self.extra.items():
            check_shape(f"{name} of {self.name!r}", column, (len(time),))
        if self.condition is not None and self.condition.shape != time.shape:
            raise ShapeError(f"condition of {self.name!r}: expected shape {time.shape}, got {self.condition.shape}")

    @property
    def changes(self) -> BoolArray:
        """Where the next row is of another condition, (N - 1,)."""
        if self.condition is None:
            return np.zeros(len(self.time) - 1, dtype=bool)
        found: BoolArray = self.condition[1:] != self.condition[:-1]
        return found

    def condition_at(self, row: int) -> str:
        """Return the condition of a row, "" if none is known."""
        return "" if self.condition is None else str(self.condition[row])
