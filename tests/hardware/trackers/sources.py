"""Sources that the tests run in a process of their own."""

from __future__ import annotations

import ctypes
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hardware.connection import Measurement
from hardware.trackers.motion_capture import MotionCaptureTracker
from hardware.trackers.process import ProcessTracker
from hardware.trackers.tracker import TrackerStream
from sysid_evo.errors import LinkLost


@dataclass(frozen=True)
class ScriptedTracker(ProcessTracker):
    """Does what ``script`` says after ``count`` frames ``period`` s apart."""

    body: str = "car"
    script: str = "end"
    count: int = 5
    period: float = 0.005
    name = "scripted"

    def frames(self) -> Iterator[Measurement | None]:
        if self.script == "refuse":
            raise LinkLost("the source refuses: ü " + "x" * 900)
        if self.script == "mute":
            time.sleep(60.0)
        yield None
        for number in range(self.count):
            now = time.monotonic()
            valid = number % 3 != 1
            yield Measurement(now - 0.004, now, number, self.body, valid, np.array([0.1 * number, 1.0, -0.5]))
            time.sleep(self.period)
        if self.script == "break":
            raise ZeroDivisionError("in the driver")
        if self.script == "crash":
            os.abort()
        if self.script == "hang":  # inside C, with the interpreter locked
            ctypes.PyDLL(None).sleep(60)


@dataclass(frozen=True)
class MissingTracker(ScriptedTracker):
    """Needs a package that nobody has."""

    requires: ClassVar[tuple[str, ...]] = ("no_such_package",)


@dataclass(frozen=True)
class MockTracker(MotionCaptureTracker):
    """The mock system that the package motioncapture brings: one body that never moves, 100 times a second."""

    rigid_bodies: str = "car(1000,2000,30,0.7071068,0,0,0.7071068)"
    name = "mock"
    kind: ClassVar[str] = "mock"

    @property
    def settings(self) -> dict[str, str]:
        return {"frequency": "100", "rigid_bodies": self.rigid_bodies}


@dataclass(frozen=True)
class PolledMockTracker(MockTracker):
    """The same as a system that repeats its last pose."""

    polls: ClassVar[bool] = True


def read_all(stream: TrackerStream) -> tuple[list[Measurement], str]:
    """Return what is measured until the source ends, and what is then said."""
    frames = []
    try:
        while True:
            frame = stream.read(5.0)
            assert frame is not None
            frames.append(frame)
    except LinkLost as error:
        return frames, str(error)
