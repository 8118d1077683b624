"""A simulated connection in real time."""

from __future__ import annotations

import time
from dataclasses import replace

from hardware.connection import Connection, Measurement
from sysid_evo.types import Array

FRAME = 0.005  # s


class Paced(Connection):
    """Another's connection in simulated time, whose frames come when they are due on the host's clock.

    ``sent`` holds the time and the control of every command, ``closed`` when it was first closed.
    """

    def __init__(self, connection: Connection) -> None:
        self.connection = connection
        self.began = time.monotonic()
        self.sent: list[tuple[float, Array]] = []
        self.closed: float | None = None

    @property
    def time(self) -> float:
        return time.monotonic()

    def send(self, control: Array, *, valid_for: float) -> None:
        self.sent.append((time.monotonic(), control))
        self.connection.send(control, valid_for=valid_for)

    def measure(self, timeout: float) -> Measurement | None:
        due = self.began + self.connection.time + FRAME
        wait = due - time.monotonic()
        if wait > timeout:
            time.sleep(timeout)
            return None
        time.sleep(max(0.0, wait))
        frame = self.connection.measure(FRAME)
        return None if frame is None else replace(frame, source_time=due, arrival_time=due)

    def close(self) -> None:
        if self.closed is None:
            self.closed = time.monotonic()
        self.connection.close()
