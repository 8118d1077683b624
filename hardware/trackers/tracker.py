"""The contract of a tracker, and tools of drivers: axes to the plane, source clock to host clock."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from hardware.arguments import check_choice, check_number
from hardware.connection import Closeable, Measurement
from sysid_evo.extras import check_installed
from sysid_evo.types import Array


class TrackerStream(Closeable):
    """An open tracker; use it in a ``with`` statement. One thread reads it."""

    @abstractmethod
    def read(self, timeout: float) -> Measurement | None:
        """Return the next frame, or None if there is none within ``timeout`` s. Raises `LinkLost`.

        Frames that arrive between calls are kept and returned in turn.
        """

    @abstractmethod
    def fileno(self) -> int:
        """Return a descriptor that is readable while a frame is waiting, for `select`."""

    @abstractmethod
    def close(self) -> None:
        """End the stream and its source; a second call does nothing."""


class Tracker(ABC):
    """A source of poses of one ``body``, described by its arguments and opened for a session.

    The constructor checks its arguments and accesses no network, device or file. ``requires`` are the modules that it
    imports only when it is opened.
    """

    requires: ClassVar[tuple[str, ...]] = ()
    name: str
    body: str

    def check(self) -> None:
        """Raise the errors of `open` that can be detected without opening anything: a package, a file."""
        check_installed(f"tracker {self.name!r}", self.requires)

    @abstractmethod
    def open(self) -> TrackerStream:
        """Start it. Raises `LinkLost` if nothing answers, `MissingExtra` if a package is not installed."""


@dataclass(frozen=True)
class Axes:
    """Axes of a tracker: which of them is vertical (``up``), and its unit of length in m.

    With z up, x and y are the tracker's; with y up they are its x and -z, so that both are right-handed. The heading is
    the direction of the x axis of the body's own frame, plus ``heading_offset`` rad.
    """

    up: Literal["y", "z"] = "z"
    scale: float = 1.0
    heading_offset: float = 0.0

    def __post_init__(self) -> None:
        check_choice("tracker: up", self.up, ("y", "z"))
        check_number("tracker: scale", self.scale, above=0.0)
        check_number("tracker: heading_offset", self.heading_offset)

    def planar(self, position: Sequence[float], rotation: Sequence[float]) -> Array:
        """Return x, y in m and heading in [-pi, pi) of a body at ``position`` turned by ``rotation`` (x, y, z, w)."""
        qx, qy, qz, qw = (float(value) for value in rotation)
        forward = (
            1.0 - 2.0 * (qy * qy + qz * qz),
            2.0 * (qx * qy + qz * qw),
            2.0 * (qx * qz - qy * qw),
        )
        x, y = self._plane(position)
        heading = math.atan2(*self._plane(forward)[::-1]) + self.heading_offset
        turned = math.remainder(heading, 2.0 * math.pi)
        return np.array([self.scale * x, self.scale * y, -math.pi if turned == math.pi else turned])

    def _plane(self, vector: Sequence[float]) -> tuple[float, float]:
        return float(vector[0]), float(vector[1]) if self.up == "z" else -float(vector[2])


LEAK = 2e-4
"""Upward drift of the offset that is followed, in s per s: more than two quartz clocks differ by."""
RESTART = 1.0  # s: a jump of the source's clock against the host's beyond this is a restart


class SourceClock:
    """Maps times of a source to `time.monotonic` by the smallest difference of arrival and source time so far.

    The smallest difference is that of the frame with the shortest transport, so a mapped time is late by that
    transport, and never by a queue in between. The offset rises by `LEAK`, to follow a source that runs slow. After a
    jump of the clock it starts again; ``restarts`` counts that.
    """

    def __init__(self) -> None:
        self._offset = math.inf
        self._newest = -math.inf
        self.restarts = 0

    def map(self, source: float, arrival: float) -> float:
        """Return the host time (s) at which a frame of ``source`` s, arrived at ``arrival`` s, was sent."""
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
