"""The emulated car in real time: its simulated seconds are those of the host's clock."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

from hardware.connection import Measurement
from hardware.emulation.tracked_robots import TrackedRobot
from sysid_evo.types import Array

MOST_BEHIND = 1.0  # s: a process that was stopped for longer goes on from now, instead of catching up


class MovingCar:
    """A session with ``car`` whose frames are due at whole multiples of its step after ``start`` (s).

    Steps that were missed are caught up; ``given_up`` counts those that were not, ``lateness`` is the
    longest that a step has waited, in s.
    """

    def __init__(self, car: TrackedRobot, *, seed: int, start: float) -> None:
        self._connection = car.connect(seed=seed)
        self._dt = car.physics.system.dt
        self._origin = start
        self.frames = self.given_up = 0
        self.lateness = 0.0

    @property
    def due(self) -> float:
        """When the next frame has to be taken (s)."""
        return self._origin + self.frames * self._dt

    def move(self, now: float, control: Array) -> Iterator[Measurement]:
        """Take the steps that are due at ``now`` under ``control`` (nu,); yield the tracker's frame after each."""
        behind = now - self.due
        if behind > MOST_BEHIND:
            missed = int(behind / self._dt)
            self.given_up += missed
            self._origin += missed * self._dt
        self.lateness = max(self.lateness, behind)
        self._connection.send(control, valid_for=math.inf)
        while self.due <= now:
            frame = self._connection.measure(self._dt)
            if frame is None:  # pragma: no cover
                raise RuntimeError("a step of simulated time brings a frame")
            self.frames += 1
            yield replace(
                frame,
                source_time=self._origin + frame.source_time,
                arrival_time=self._origin + frame.arrival_time,
            )
