"""Trials of a task driven by hand, one after the other."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import count

from hardware.driving.human_pilot import HumanPilot
from hardware.driving.instruments import Instruments
from hardware.driving.keyboard import Keyboard
from hardware.driving.while_driving import WhileDriving
from hardware.listener import Listener
from hardware.loop.control_loop import ControlLoop
from hardware.loop.demands import check_loop
from hardware.loop.report import LoopReport
from hardware.loop.stops import Stops
from hardware.robot import Robot
from hardware.trackers.gates import GateLimits
from sysid_evo.arrays import Array
from sysid_evo.data import Trajectory
from sysid_evo.tasks import Task, TaskState

POLL = 0.02  # s between two looks at whether a new trial is wanted


@dataclass(frozen=True)
class HandTrial:
    """One trial, from connecting to letting go of the robot; ``number`` counts from 1.

    ``fitness`` is None unless it was driven to its end; ``report`` tells how the loop went,
    ``limits`` how far its gate believed the tracker.
    """

    number: int
    name: str
    seed: int
    fitness: float | None
    trajectory: Trajectory | None
    task_state: TaskState
    report: LoopReport
    limits: GateLimits


class HandDriving:
    """Lets a person drive trials of ``task`` on ``robot``, each in a session of its own.

    Between trials nothing is connected, and the robot drives only after the person has asked for a
    trial, released all keys and pressed one. The task's origin is where the robot stands at the first
    trial, or that of the tracker (``origin`` all zero). ``seed_of`` gives the seed of a trial, from 0;
    it also fixes what an emulated robot draws. ``recorder`` makes the listener that is told of a trial
    while it is driven, given the trial's name; it is closed after it.
    """

    def __init__(
        self,
        robot: Robot,
        task: Task,
        keyboard: Keyboard,
        instruments: Instruments,
        *,
        seed_of: Callable[[int], int],
        stops: Stops,
        recorder: Callable[[str, GateLimits], Listener] | None = None,
        origin: Array | None = None,
    ) -> None:
        check_loop(robot.system)
        self._robot = robot
        self._task = task.bind(robot.system)
        self._keyboard = keyboard
        self._instruments = instruments
        self._seed_of = seed_of
        self._stops = stops
        self._recorder = recorder
        self._origin = origin

    def trials(self) -> Iterator[HandTrial]:
        """Yield the trials as they end; a stop from outside ends them. Raises `LinkLost` if none connects.

        A trial that a fault cuts short is yielded too, and the person may ask for the next one.
        """
        for index in count():
            trial = self._drive(index)
            self._instruments.finish(trial.fitness, trial.report.sentence if trial.report.reason.is_fault else "")
            yield trial
            if not self._wanted():
                return

    def _drive(self, index: int) -> HandTrial:
        seed, name = self._seed_of(index), f"trial-{index + 1}"
        pilot = HumanPilot(self._keyboard, self._task, seed=seed, origin=self._origin)
        listeners: list[Listener] = [self._instruments]
        try:
            with self._robot.connect(seed=seed) as connection:
                if self._recorder is not None:
                    listeners.append(WhileDriving(pilot, partial(self._recorder, name, connection.gate_limits)))
                self._instruments.begin(pilot, index + 1)
                loop = ControlLoop(connection, self._robot.system, listeners=listeners, stops=self._stops)
                report, limits = loop.run(pilot), connection.gate_limits
        finally:
            pilot.end()
            for listener in listeners:
                listener.close()
        self._origin = pilot.origin
        return HandTrial(index + 1, name, seed, pilot.fitness, pilot.trajectory(name), pilot.task_state, report, limits)

    def _wanted(self) -> bool:
        """Wait until the person wants a new trial; return False if the session is stopped instead."""
        while self._stops.reason is None:
            if self._keyboard.take_new_trial():
                return True
            time.sleep(POLL)
        return False
