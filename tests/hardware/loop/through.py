"""A connection around another with a fault at a time, and pilots and listeners that write down what they see."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np

from hardware.connection import Command, Connection, Listener, Measurement, RobotStatus
from hardware.control_loop import Pilot
from hardware.estimator import StateEstimate
from hardware.robot import Robot
from sysid_evo.angles import rotate
from sysid_evo.errors import LinkLost
from sysid_evo.types import Array


@dataclasses.dataclass
class Faults:
    """When (s) frames lose the body, sending fails, the robot trips; ``slow``: frames that a send at a time takes.

    ``placed`` is the pose of the tracker's origin, as the robot's frame sees it, ``moved`` another one
    from a time on; from ``frozen_at`` on all frames show the same pose.
    """

    lost: tuple[float, float] = (math.inf, math.inf)
    broken_at: float = math.inf
    tripped_at: float = math.inf
    slow: dict[float, int] = dataclasses.field(default_factory=dict)
    placed: tuple[float, float, float] = (0.0, 0.0, 0.0)
    moved: tuple[float, tuple[float, float, float]] = (math.inf, (0.0, 0.0, 0.0))
    frozen_at: float = math.inf


class Through(Connection):
    """Another's connection, with faults."""

    def __init__(self, connection: Connection, faults: Faults) -> None:
        self.connection, self.faults = connection, faults
        self.closed = False
        self.driven = False
        self.waiting: list[Measurement | None] = []
        self.frozen: Measurement | None = None

    @property
    def time(self) -> float:
        return self.connection.time

    @property
    def status(self) -> RobotStatus | None:
        if self.time < self.faults.tripped_at:
            return None
        return RobotStatus(self.time, self.time, "tripped", np.zeros(2))

    def send(self, control: Array, *, valid_for: float) -> None:
        if self.time >= self.faults.broken_at:
            raise LinkLost("nothing was heard for 0.25 s")
        self.connection.send(control, valid_for=valid_for)
        self.driven = self.driven or bool(control.any())
        for _ in range(self.faults.slow.pop(round(self.time, 3), 0)):
            self.waiting.append(self.connection.measure(1.0))

    def measure(self, timeout: float) -> Measurement | None:
        frame = self.waiting.pop(0) if self.waiting else self.connection.measure(timeout)
        if frame is None:
            return None
        x, y, heading = self.faults.placed if self.time < self.faults.moved[0] else self.faults.moved[1]
        if self.time >= self.faults.frozen_at:
            self.frozen = self.frozen or frame
            frame = dataclasses.replace(frame, pose=self.frozen.pose)
        dx, dy = rotate(frame.pose[0], frame.pose[1], np.array(heading))
        valid = not self.faults.lost[0] < self.time <= self.faults.lost[1]
        return dataclasses.replace(frame, valid=valid, pose=np.array([x + dx, y + dy, frame.pose[2] + heading]))

    def close(self) -> None:
        self.closed = True
        self.connection.close()


class FaultyRobot(Robot):
    """Another robot behind such a connection; keeps the last one."""

    dynamics = None

    def __init__(self, robot: Robot, **faults: object) -> None:
        self.name, self.system, self.robot = f"faulty {robot.name}", robot.system, robot
        self.faults = Faults(**faults)  # type: ignore[arg-type]  # as the test names them
        self.connection: Through | None = None

    def connect(self, *, seed: int | None = None) -> Through:
        self.connection = Through(self.robot.connect(seed=seed), self.faults)
        return self.connection


class Script(Pilot):
    """Asks a function for the control of a sample, and keeps the estimates."""

    def __init__(self, control: Callable[[int], Array | None]) -> None:
        self.control = control
        self.ticks: list[int] = []
        self.estimates: list[StateEstimate] = []

    def decide(self, tick: int, estimate: StateEstimate) -> Array | None:
        self.ticks.append(tick)
        self.estimates.append(estimate)
        return self.control(tick)


class Diary(Listener):
    """Writes down what it is told."""

    def __init__(self) -> None:
        self.measurements: list[Measurement] = []
        self.commands: list[Command] = []
        self.statuses: list[RobotStatus] = []

    def measured(self, measurement: Measurement) -> None:
        self.measurements.append(measurement)

    def commanded(self, command: Command) -> None:
        self.commands.append(command)

    def reported(self, status: RobotStatus) -> None:
        self.statuses.append(status)
