"""From a tracker's clock to the host's."""

from __future__ import annotations

import math

LEAK = 2e-4
"""Upward drift of the offset that is followed, in s per s: more than two quartz clocks part by."""
RESTART = 1.0  # s that the source's clock may jump back or ahead of the host's before it counts as set anew


class SourceClock:
    """Maps times of a source onto `time.monotonic` by the smallest difference of arrival and source time seen.

    The smallest difference belongs to the frame that travelled fastest, so a mapped time is late by
    the shortest way from the source to here, and never by a queue in between. The offset leaks
    upward by `LEAK`, to follow a source that runs slow. A clock that jumps starts anew; ``restarts``
    counts that.
    """

    def __init__(self) -> None:
        self._offset = math.inf
        self._newest = -math.inf
        self.restarts = 0

    def map(self, source: float, arrival: float) -> float:
        """Return when a frame of ``source`` s that came at ``arrival`` s was sent, in s of the host; never later."""
        if math.isfinite(self._offset):
            jumped_back = source < self._newest - RESTART
            jumped_ahead = arrival - source < self._offset - RESTART
            if jumped_back or jumped_ahead:
                self._offset, self._newest = math.inf, -math.inf
                self.restarts += 1
            else:
                self._offset += LEAK * max(source - self._newest, 0.0)
        self._offset = min(self._offset, arrival - source)
        self._newest = max(self._newest, source)
        return min(source + self._offset, arrival)
