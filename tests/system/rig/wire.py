"""One direction of the serial line: bytes go in, and come out in order."""

from __future__ import annotations

import math
from collections import deque

from tests.system.rig.faults import FaultSchedule


class Wire:
    """Bytes under way from one end to the other."""

    def __init__(self, faults: FaultSchedule) -> None:
        self._faults = faults
        self._under_way: deque[tuple[float, int]] = deque()

    def push(self, data: bytes, now: float) -> None:
        """Send ``data`` at time ``now`` (s)."""
        for byte in data:
            due = max(now, self._faults.end("stall", now), self._under_way[-1][0] if self._under_way else now)
            self._under_way.append((due, byte))

    def pull(self, now: float) -> bytes:
        """Return the bytes that have arrived by ``now``."""
        arrived = bytearray()
        while self._under_way and self._under_way[0][0] <= now:
            arrived.append(self._under_way.popleft()[1])
        return bytes(arrived)

    def clear(self) -> None:
        """Lose everything under way."""
        self._under_way.clear()

    @property
    def due(self) -> float:
        """When the next byte arrives; inf if none is under way."""
        return self._under_way[0][0] if self._under_way else math.inf
