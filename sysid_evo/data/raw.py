"""A log as a recorder writes it: poses and commands on the tracker's clock, not yet a data set."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from sysid_evo.arrays import Array, check_shape


@dataclass(frozen=True)
class RawLog:
    """N rows of one recording, before preparation.

    ``time`` (N,) in s; ``pose`` (N, n_pose) in the units of the system's motion; ``controls``
    (N, nu): the command in force from this row on; ``extra``: other columns (N,), by name.
    """

    name: str
    time: Array
    pose: Array
    controls: Array
    extra: Mapping[str, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        time = check_shape(f"time of {self.name!r}", self.time, (None,))
        object.__setattr__(self, "time", time)
        object.__setattr__(self, "pose", check_shape(f"pose of {self.name!r}", self.pose, (len(time), None)))
        object.__setattr__(
            self, "controls", check_shape(f"controls of {self.name!r}", self.controls, (len(time), None))
        )
        for name, column in self.extra.items():
            check_shape(f"{name} of {self.name!r}", column, (len(time),))
