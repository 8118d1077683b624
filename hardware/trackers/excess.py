"""By how much the frames that a gate dropped go beyond its limits, in words that say what to set."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping

import numpy as np

from hardware.measurement import Measurement

SHARE = 0.9
NOTHING = (0.0, 0.0)
REMEMBERED = 200  # frames: a second at 200 Hz, longer than a run goes on without a pose
WORDS = {
    "speed": ("it moves at {:.1f} m/s", "m/s"),
    "yaw_rate": ("it turns at {:.1f} rad/s", "rad/s"),
    "jump": ("it was seen {:.2f} m from where it was", "m"),
    "turn": ("it was seen turned by {:.2f} rad", "rad"),
}
"""What is said of a value beyond each limit, and the limit's unit; the first that holds explains the others."""


class Excess:
    """Remembers how the body moved while its frames were not believed; ``limits`` are the four of `WORDS`.

    One frame far away is a mistake of the tracker; a robot that is faster than its limits is fast from
    frame to frame. So a speed counts if a tenth of the steps between neighbouring frames, and at least
    one other, are as fast; the robot brakes as soon as it is lost.
    """

    def __init__(self, limits: Mapping[str, float]) -> None:
        self._limits = limits
        self._steps: deque[tuple[float, float]] = deque(maxlen=REMEMBERED)
        self._away = NOTHING

    def clear(self) -> None:
        """Forget everything: a frame was believed."""
        self._steps.clear()

    def add(self, believed: Measurement, before: Measurement, frame: Measurement) -> None:
        """Take in a dropped ``frame``, the one ``before`` it, and the last that was ``believed``."""
        self._away = distance(believed, frame), turn(believed, frame)
        dt = frame.source_time - before.source_time
        if dt > 0.0:
            self._steps.append((distance(before, frame) / dt, turn(before, frame) / dt))

    @property
    def sentence(self) -> str:
        """What was seen, the limit it is beyond and the key that sets it; "" if nothing is beyond one."""
        if not self._steps:
            return ""
        fast = np.quantile(np.array(self._steps), SHARE, axis=0, method="lower").tolist()
        seen = (*(fast if len(self._steps) > 1 else NOTHING), *self._away)
        for value, (key, (words, unit)) in zip(seen, WORDS.items(), strict=True):
            if value > self._limits[key]:
                return (
                    f"{words.format(value)}, and a frame is believed up to {key} = {self._limits[key]:g} {unit}; "
                    f"if the robot can do that, set {key} in [gate] of its file"
                )
        return ""


def distance(before: Measurement, after: Measurement) -> float:
    """Return how far two planar poses lie apart, in m."""
    return math.hypot(after.pose[0] - before.pose[0], after.pose[1] - before.pose[1])


def turn(before: Measurement, after: Measurement) -> float:
    """Return by how much two planar poses are turned against each other, 0 to pi rad."""
    return abs(math.remainder(after.pose[2] - before.pose[2], 2.0 * math.pi))
