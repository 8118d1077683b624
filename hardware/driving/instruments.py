"""What a driver looks at: the newest of everything that is known, for the page to ask for at any time."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from hardware.driving.human_pilot import HumanPilot, Phase
from hardware.driving.keyboard import ALL_KEYS, Keyboard
from hardware.listener import Command, Listener, RobotStatus
from hardware.measurement import Measurement
from hardware.robot import Robot
from sysid_evo.arrays import Array
from sysid_evo.tasks import Task

RATE_SPAN = 0.5  # s over which the rate of the tracker is counted


class Instruments(Listener):
    """A listener that remembers the newest; another thread reads it with `reading`.

    Every attribute is replaced as a whole, so that a reader never sees half of a change.
    """

    def __init__(
        self, robot: Robot, task: Task, keyboard: Keyboard, *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._robot = robot
        self._task = task
        self._keyboard = keyboard
        self._clock = clock
        self._pilot: HumanPilot | None = None
        self._number = 0
        self._frame: Measurement | None = None
        self._arrived = -math.inf
        self._command: Command | None = None
        self._status: RobotStatus | None = None
        self._counted = (clock(), 0, 0.0)
        self._scores: tuple[float, ...] = ()
        self._message = ""

    def begin(self, pilot: HumanPilot, number: int) -> None:
        """Show the trial of ``pilot``, the ``number``-th from 1."""
        self._pilot, self._number, self._message = pilot, number, ""
        self._frame = self._command = self._status = None
        self._arrived = -math.inf

    def finish(self, score: float | None, message: str = "") -> None:
        """Show the ``score`` of the trial that is over, if it has one, and what there is to say."""
        self._message = message
        self._command = None
        if score is not None:
            self._scores = (*self._scores, score)

    def measured(self, measurement: Measurement) -> None:
        now = self._clock()
        began, frames, rate = self._counted
        frames += measurement.valid
        span = now - began
        self._counted = (now, 0, frames / span) if span >= RATE_SPAN else (began, frames, rate)
        if measurement.valid:
            self._frame, self._arrived = measurement, now

    def commanded(self, command: Command) -> None:
        self._command = command

    def reported(self, status: RobotStatus) -> None:
        self._status = status

    def setting(self) -> dict[str, Any]:
        """Return what stays the same in a session, as strict JSON."""
        system = self._robot.system
        task = self._task.bind(system)
        scene = task.scene(task.begin(np.zeros(1, dtype=np.uint64)), 0)
        return {
            "robot": self._robot.name,
            "dt": system.dt,
            "horizon": task.horizon,
            "unit": task.fitness_unit,
            "arena": scene.extent,
            "waypoint_radius": scene.radius or None,
            "controls": [channel.name for channel in (system.controls[0], system.controls[-1])][: system.nu],
        }

    def reading(self) -> dict[str, Any]:
        """Return what there is to see now, as strict JSON; poses are seen from the task's origin."""
        now, frame, command, status, pilot = self._clock(), self._frame, self._command, self._status, self._pilot
        progress = None if pilot is None else pilot.progress
        age = now - self._arrived
        return {
            "trial": self._number,
            "phase": (Phase.ENDED if progress is None else progress.phase).value,
            "time_left": self._task.horizon * self._robot.system.dt
            if progress is None
            else (self._task.horizon - progress.steps) * self._robot.system.dt,
            "score": 0.0 if progress is None else progress.score,
            "scores": list(self._scores),
            "waypoint": None if progress is None or progress.waypoint is None else progress.waypoint.tolist(),
            "pose": None if frame is None or pilot is None else pilot.in_arena(frame.pose).tolist(),
            "speed": None if pilot is None else self._speed(pilot.newest_state),
            "control": None if command is None else command.control[[0, -1]][: self._robot.system.nu].tolist(),
            "keys": self._keyboard.keys & ALL_KEYS,
            "tracker": None if not math.isfinite(age) else {"age": round(age, 3), "rate": round(self._counted[2])},
            "link": None if status is None else {"state": status.state, "age": round(now - status.time, 3)},
            "message": self._message,
        }

    def _speed(self, state: Array | None) -> float | None:
        system = self._robot.system
        forward = None if system.motion is None else system.motion.roles().get("forward")
        if state is None or forward is None or not np.isfinite(state).all():
            return None
        return float(state[system.state_names.index(forward)])
