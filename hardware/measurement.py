"""One frame of a tracker: where a body was seen, and when."""

from __future__ import annotations

from dataclasses import dataclass

from sysid_evo.arrays import Array


@dataclass(frozen=True)
class Measurement:
    """One frame of a tracker.

    ``source_time`` is when the frame was taken, ``arrival_time`` when it got here. Both are in s on
    one clock, that of the connection; a tracker with a clock of its own is mapped onto the host's
    (`time.monotonic`). ``pose`` (n_pose,) is in the units of the system's motion; where ``valid``
    is false the tracker has lost ``body`` and the pose means nothing.
    """

    source_time: float
    arrival_time: float
    frame: int
    body: str
    valid: bool
    pose: Array
