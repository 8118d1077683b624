"""Simulated time in step with the host's clock, so that a person can drive what only exists as dynamics."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import replace

from hardware.connection import Connection
from hardware.emulation.simulated_robot import SimulatedConnection, SimulatedRobot
from hardware.listener import RobotStatus
from hardware.measurement import Measurement
from hardware.robot import Robot
from hardware.trackers.gates import GateLimits
from sysid_evo.arrays import Array


def in_real_time(robot: Robot) -> Robot:
    """Return ``robot`` if its sessions run on the host's clock, else its paced form."""
    return PacedRobot(robot) if isinstance(robot, SimulatedRobot) else robot


class PacedRobot(Robot):
    """A simulated robot whose sessions keep pace with `time.monotonic`."""

    def __init__(self, robot: SimulatedRobot) -> None:
        self.robot = robot
        self.name, self.system, self.dynamics = robot.name, robot.system, robot.dynamics

    def connect(self, *, seed: int | None = None) -> PacedConnection:
        return PacedConnection(self.robot.connect(seed=seed))


class PacedConnection(Connection):
    """A session of ``simulated`` on the host's clock, on which it began at 0 s.

    The robot moves on its own, as a real one does, whether or not anybody looks: whoever calls late
    finds the frames of the time in between waiting, and commands that have expired meanwhile have
    had their effect no longer than they were valid.
    """

    def __init__(self, simulated: SimulatedConnection) -> None:
        self.simulated = simulated
        self._began = time.monotonic()
        self._waiting: deque[Measurement] = deque()

    @property
    def time(self) -> float:
        return time.monotonic()

    @property
    def gate_limits(self) -> GateLimits:
        return self.simulated.gate_limits

    @property
    def status(self) -> RobotStatus | None:
        said = self.simulated.status
        return None if said is None else replace(said, time=said.time + self._began)

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
        """Let the robot move up to now, which is returned."""
        self.simulated.check_open()
        now = time.monotonic()
        while self._due <= now:
            seen = self.simulated.measure(self.simulated.period)
            assert seen is not None
            source, arrival = seen.source_time + self._began, seen.arrival_time + self._began
            self._waiting.append(replace(seen, source_time=source, arrival_time=arrival))
        return now
