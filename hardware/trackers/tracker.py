"""The contract of a tracker, and what a driver keeps it with: axes to the plane, source clock to host clock."""

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

        Frames that came in between calls are kept and returned in turn.
        """

    @abstractmethod
    def fileno(self) -> int:
        """Return a descriptor that is readable while a frame is waiting, for `select`."""

    @abstractmethod
    def close(self) -> None:
        """End the stream and whatever feeds it; a second call does nothing."""


class Tracker(ABC):
    """A source of poses of one ``body``, described by its arguments and opened for a session.

    The constructor checks its arguments and touches nothing else: no network, no device, no file.
    ``requires`` are the modules that it imports only when it is opened.
    """

    requires: ClassVar[tuple[str, ...]] = ()
    name: str
    body: str

    def check(self) -> None:
        """Raise what `open` would raise and what can be known without opening anything: a package, a file."""
        check_installed(f"tracker {self.name!r}", self.requires)

    @abstractmethod
    def open(self) -> TrackerStream:
        """Start it. Raises `LinkLost` if nothing answers, `MissingExtra` if a package is not installed."""


@dataclass(frozen=True)
class Axes:
    """How a tracker sees the plane: which of its axes points ``up``, and how many m its unit of length is.

    With z up, x and y are the tracker's; with y up they are its x and -z, so that both are right-handed.
    The heading is where the x axis of the body's own frame points, plus ``heading_offset`` rad.
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
