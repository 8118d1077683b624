"""What a driver looks at: the newest of everything that is known, for the page to ask for at any time."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

from hardware.driving.human_pilot import HumanPilot, Phase
from hardware.driving.keyboard import ALL_KEYS, Keyboard
from hardware.driving.panel import first_scene, numbers, scenery_of, setting_of, speed_of, traced
from hardware.listener import Command, Listener, RobotStatus
from hardware.measurement import Measurement
from hardware.robot import Robot
from sysid_evo.tasks import Scene, Task

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
        self._places = list(traced(robot.system, first_scene(task.bind(robot.system))))

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
        return setting_of(self._robot.name, self._task.bind(self._robot.system), by_hand=True)

    def scenery(self) -> dict[str, Any]:
        """Return the walls and targets of the trial, as strict JSON."""
        pilot = self._pilot
        scene = Scene() if pilot is None else self._task.scene(pilot.task_state, 0)
        return scenery_of(self._robot.system, scene)

    def reading(self) -> dict[str, Any]:
        """Return what there is to see now, as strict JSON; poses are seen from the task's origin."""
        now, frame, command, status, pilot = self._clock(), self._frame, self._command, self._status, self._pilot
        progress = None if pilot is None else pilot.progress
        age = now - self._arrived
        return {
            "trial": self._number,
            "step": 0 if progress is None else progress.steps,
            "phase": (Phase.ENDED if progress is None else progress.phase).value,
            "time_left": self._task.horizon * self._robot.system.dt
            if progress is None
            else (self._task.horizon - progress.steps) * self._robot.system.dt,
            "score": 0.0 if progress is None else progress.score,
            "scores": list(self._scores),
            "waypoint": None if progress is None or progress.waypoint is None else progress.waypoint.tolist(),
            "pose": None if frame is None or pilot is None else pilot.in_arena(frame.pose).tolist(),
            "speed": None if pilot is None else speed_of(self._robot.system, pilot.newest_state),
            "state": None if pilot is None or pilot.newest_state is None else numbers(pilot.newest_state[self._places]),
            "control": None if command is None else command.control.tolist(),
            "keys": self._keyboard.keys & ALL_KEYS,
            "tracker": None if not math.isfinite(age) else {"age": round(age, 3), "rate": round(self._counted[2])},
            "link": None if status is None else {"state": status.state, "age": round(now - status.time, 3)},
            "message": self._message,
        }
