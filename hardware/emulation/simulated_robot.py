"""What the robots that exist only as dynamics have in common: a clock that moves when it is asked to."""

from __future__ import annotations

import math
from abc import abstractmethod

import numpy as np

from hardware.connection import Connection
from hardware.measurement import Measurement
from hardware.robot import Robot
from sysid_evo.arrays import Array
from sysid_evo.errors import InvalidArgument, LinkLost
from sysid_evo.system import System

CLOCK_TOLERANCE = 1e-9  # s


class SimulatedRobot(Robot):
    """A robot whose sessions run in simulated time, with a frame of the tracker every ``frame_period`` s."""

    frame_period: float

    @abstractmethod
    def connect(self, *, seed: int | None = None) -> SimulatedConnection:
        """Open a session at rest in the origin; without a seed each session draws its own noise."""


class SimulatedConnection(Connection):
    """A session in simulated time: nothing waits, the clock is the tracker's.

    The first `measure` is the frame at 0 s; each further one lets the robot move for ``period`` s.
    ``control`` (nu,) is the command in force, ``pose`` (n_pose,) the true one.
    """

    def __init__(self, name: str, system: System, period: float) -> None:
        self.name = name
        self.period = period
        self.frame = -1
        self.control = self._neutral = system.neutral_control
        self.pose = np.zeros(system.n_pose)
        self._system = system
        self._expires = -math.inf
        self._open = True
        self._waited = 0.0

    @property
    def time(self) -> float:
        """The clock in s: the time of the last frame, 0 before the first."""
        return max(self.frame, 0) * self.period

    def send(self, control: Array, *, valid_for: float) -> None:
        self.check_open()
        control = self._system.check_control(control).copy()
        if not valid_for > 0.0:
            raise InvalidArgument(f"send: expected valid_for > 0 s, got {valid_for}")
        self.control, self._expires = control, self.time + valid_for

    def measure(self, timeout: float) -> Measurement | None:
        self.check_open()
        if self.frame >= 0:
            self._waited += timeout
            if self._waited + CLOCK_TOLERANCE < self.period:
                return None
            self._waited = 0.0
            if self.time + CLOCK_TOLERANCE >= self._expires:
                self.control = self._neutral
            self._advance()
        self.frame += 1
        return self._look(self.time)

    def close(self) -> None:
        self.control, self._open = self._neutral, False

    @abstractmethod
    def _advance(self) -> None:
        """Let the robot move for ``period`` s under ``control``."""

    @abstractmethod
    def _look(self, time: float) -> Measurement:
        """Return the frame that is taken at ``time``."""

    def check_open(self) -> None:
        """Raise `LinkLost` if the session is closed."""
        if not self._open:
            raise LinkLost(f"the connection to {self.name!r} is closed: open another with connect()")
