"""Robots in simulated time: a session whose clock is the tracker's, and its real-time form."""

from __future__ import annotations

import math
import time
from abc import abstractmethod
from collections import deque
from dataclasses import replace

import numpy as np

from hardware.connection import Connection, Measurement, RobotStatus
from hardware.robot import Robot
from sysid_evo.errors import InvalidArgument, LinkLost
from sysid_evo.models.dynamics import Dynamics, started
from sysid_evo.system import System
from sysid_evo.types import Array

CLOCK_TOLERANCE = 1e-9  # s


class SimulatedRobot(Robot):
    """A robot whose sessions run in simulated time."""

    @abstractmethod
    def connect(self, *, seed: int | None = None) -> SimulatedConnection:
        """Open a session at rest in the origin; without a seed each session draws its own noise."""


class SimulatedConnection(Connection):
    """A session in simulated time: nothing waits, the clock is the tracker's.

    The first `measure` is the frame at 0 s; for each further one the robot moves for ``period`` s. ``control`` (nu,) is
    the command in force, ``pose`` (n_pose,) the true one.
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
        """Move the robot for ``period`` s under ``control``."""

    @abstractmethod
    def _look(self, time: float) -> Measurement:
        """Return the frame that is taken at ``time``."""

    def check_open(self) -> None:
        """Raise `LinkLost` if the session is closed."""
        if not self._open:
            raise LinkLost(f"the connection to {self.name!r} is closed: open another with connect()")


NOISE_BLOCK = 1024  # frames of noise drawn at once


class PhysicsConnection(SimulatedConnection):
    """A session with physics that take one step for each frame.

    Draws, noise and the errors of sensors come from ``seed``; the session begins in ``state`` (nx,), at rest by
    default.
    """

    def __init__(self, name: str, physics: Dynamics, *, seed: int | None, state: Array | None = None) -> None:
        system = physics.system
        super().__init__(name, system, system.dt)
        self._physics = physics
        body, sensors = np.random.SeedSequence(seed).spawn(2)
        self._rng, self._errors = np.random.default_rng(body), np.random.default_rng(sensors)
        began = system.neutral_state if state is None else state
        self._carry = started(physics, began[None], self._rng.standard_normal((1, physics.n_draws)))
        self._noise = np.empty((0, physics.n_noise))

    @property
    def state(self) -> Array:
        """The true state (nx,), which a real robot does not report."""
        return self._carry[0, : self._physics.system.nx].copy()

    def _stepped(self) -> Array:
        """Return the next carry."""
        row = self.frame % NOISE_BLOCK
        if row == 0:
            self._noise = self._rng.standard_normal((NOISE_BLOCK, self._physics.n_noise))
        return self._physics.step(self._carry, self.control[None], self._noise[row : row + 1])


def in_real_time(robot: Robot) -> Robot:
    """Return ``robot`` if its sessions run on the host's clock, else its real-time form."""
    return RealTimeRobot(robot) if isinstance(robot, SimulatedRobot) else robot


class RealTimeRobot(Robot):
    """A simulated robot whose sessions run in step with `time.monotonic`, so that a person can drive it."""

    def __init__(self, robot: SimulatedRobot) -> None:
        self.robot = robot
        self.name, self.system, self.dynamics = robot.name, robot.system, robot.dynamics

    def connect(self, *, seed: int | None = None) -> RealTimeConnection:
        return RealTimeConnection(self.robot.connect(seed=seed))


class RealTimeConnection(Connection):
    """A session of ``simulated`` on the host's clock, on which it began at 0 s.

    The robot moves continuously, like a real one: a late caller gets the frames of the time in between, and commands
    that have expired meanwhile have acted no longer than they were valid.
    """

    def __init__(self, simulated: SimulatedConnection) -> None:
        self.simulated = simulated
        self.gate_limits = simulated.gate_limits
        self._began = time.monotonic()
        self._waiting: deque[Measurement] = deque()

    @property
    def time(self) -> float:
        return time.monotonic()

    @property
    def status(self) -> RobotStatus | None:
        status = self.simulated.status
        return None if status is None else replace(status, time=status.time + self._began)

    def send(self, control: Array, *, valid_for: float) -> None:
        self._catch_up()
        self.simulated.send(control, valid_for=valid_for)

    def measure(self, timeout: float) -> Measurement | None:
        deadline = time.monotonic() + timeout
        while True:
            now = self._catch_up()
            if self._waiting and self._waiting[0].arrival_time <= now:
                return self._waiting.popleft()
            if now >= deadline:
                return None
            next_event = self._waiting[0].arrival_time if self._waiting else self._due
            time.sleep(min(next_event, deadline) - now)

    def close(self) -> None:
        self.simulated.close()

    @property
    def _due(self) -> float:
        """When the next frame is taken."""
        return self._began + (self.simulated.frame + 1) * self.simulated.period

    def _catch_up(self) -> float:
        """Move the robot up to the present time, which is returned."""
        self.simulated.check_open()
        now = time.monotonic()
        while self._due <= now:
            seen = self.simulated.measure(self.simulated.period)
            assert seen is not None
            source, arrival = seen.source_time + self._began, seen.arrival_time + self._began
            self._waiting.append(replace(seen, source_time=source, arrival_time=arrival))
        return now
