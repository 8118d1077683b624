"""A person drives on the local page: trials of a task, one after the other."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from itertools import count

import numpy as np

from hardware.connection import Command, GateLimits, Listener, Measurement, RobotStatus
from hardware.control_loop import ControlLoop, Pilot, check_loop
from hardware.driving.keyboard import Keyboard, control_of_keys, key_validity
from hardware.driving.page_messages import ALL_KEYS, DrivePanel, Phase, Reading
from hardware.driving.server import PageAddress, check_page, served
from hardware.driving.trials import StandstillDetector, TrialLog
from hardware.estimator import StateEstimate
from hardware.preflight import check_driving
from hardware.robot import Robot
from hardware.run_report import LoopReport, StopRequest
from sysid_evo.data import Trajectory
from sysid_evo.errors import IncompatibleSystem
from sysid_evo.tasks import Scene, Task, TaskState
from sysid_evo.types import Array

POLL = 0.02  # s between two checks for a request of a new trial


@dataclass(frozen=True)
class HandTrial:
    """One trial, from connecting to closing the connection; ``number`` counts from 1.

    ``fitness`` is None unless it was driven to its end; ``report`` is that of the loop, ``limits`` are those of its
    gate.
    """

    number: int
    name: str
    seed: int
    fitness: float | None
    trajectory: Trajectory | None
    task_state: TaskState
    report: LoopReport
    limits: GateLimits


def hand_trials(
    robot: Robot,
    task: Task,
    keyboard: Keyboard,
    instruments: HandPanel,
    *,
    seed_of: Callable[[int], int],
    stop: StopRequest,
    recorder: Callable[[str, GateLimits], Listener] | None = None,
    origin: Array | None = None,
) -> Iterator[HandTrial]:
    """Let a person drive trials of ``task`` on ``robot``, each in a session of its own; yield them as they end.

    A stop from outside ends them. A trial that a fault ends is yielded, too, and the person may ask for the next one.
    Between trials nothing is connected, and the robot drives only after the person has asked for a trial, released all
    keys and pressed one. The task's origin is the robot's pose at the first trial, or that of the tracker (``origin``
    all zero). ``seed_of`` gives the seed of a trial, from 0; it also fixes the random draws of an emulated robot.
    ``recorder`` makes a listener of a trial, given the trial's name; it is closed after the trial. Raises `LinkLost` if
    the robot does not connect.
    """
    check_loop(robot.system)
    task = task.bind(robot.system)
    for number in count(1):
        seed, name = seed_of(number - 1), f"trial-{number}"
        pilot = HumanPilot(keyboard, task, seed=seed, origin=origin)
        listeners: list[Listener] = [instruments]
        try:
            with robot.connect(seed=seed) as connection:
                limits = connection.gate_limits
                if recorder is not None:
                    listeners.append(PreTriggerBuffer(pilot, partial(recorder, name, limits)))
                instruments.begin(pilot, number)
                report = ControlLoop(connection, robot.system, listeners=listeners, stop=stop).run(pilot)
        finally:
            pilot.end()
            for listener in listeners:
                listener.close()
        origin = pilot.origin
        instruments.finish(pilot.fitness, report.sentence if report.reason.is_fault else "")
        yield HandTrial(number, name, seed, pilot.fitness, pilot.trajectory(name), pilot.task_state, report, limits)
        while stop.reason is None and not keyboard.take_new_trial():
            time.sleep(POLL)
        if stop.reason is not None:
            return


def check_driving_by_hand(robot: Robot, task: Task) -> None:
    """Raise if a person cannot drive ``robot`` at ``task`` on the page.

    Raises the errors of `check_driving`, `IncompatibleSystem` for a robot without a pose, `InvalidArgument` for
    controls that keys cannot move and `MissingExtra` if the page cannot be served.
    """
    if robot.system.motion is None:
        raise IncompatibleSystem(
            f"driving by hand: expected a robot whose pose a tracker measures, but {robot.name} has none. Use "
            "--controller and --watch to see on the page how a controller drives it"
        )
    check_page()
    control_of_keys(0, robot.system)
    key_validity(robot.system)
    check_driving(robot, task)


@contextmanager
def driven_by_hand(
    robot: Robot,
    task: Task,
    address: PageAddress,
    *,
    seed_of: Callable[[int], int],
    stop: StopRequest,
    announce: Callable[[str], None],
    recorder: Callable[[str, GateLimits], Listener] | None = None,
    tracker_origin: bool = False,
) -> Iterator[Iterator[HandTrial]]:
    """Serve the page for driving ``robot`` at ``task`` by hand; yields the trials as they end, see `hand_trials`."""
    keyboard = Keyboard(life=key_validity(robot.system))
    instruments = HandPanel(robot, task, keyboard)
    origin = np.zeros(robot.system.n_pose) if tracker_origin else None
    check_loop(robot.system)
    with served(instruments, keyboard, address, stop=stop, announce=announce):
        yield hand_trials(
            robot, task, keyboard, instruments, seed_of=seed_of, stop=stop, recorder=recorder, origin=origin
        )


class HumanPilot(Pilot):
    """Drives by the keys that are held, from the first key on, for the task's ``horizon`` samples.

    The trial can start once the robot is at rest and all keys are released. ``task`` must be bound; its trial is that
    of ``seed``. The task's ``origin`` is a pose of the tracker (3,), or the robot's at the first key. ``progress`` and
    ``newest_state`` (nx,) may be read by any thread.
    """

    def __init__(self, keyboard: Keyboard, task: Task, *, seed: int, origin: Array | None = None) -> None:
        self.origin = origin
        self._keyboard = keyboard
        self._task = task
        self.task_state: TaskState = task.begin(np.array([seed], dtype=np.uint64))
        self._tape = TrialLog()
        self._rest = StandstillDetector()
        self._began = 0
        self.newest_state: Array | None = None
        self.progress = self._progress(Phase.SETTLING)

    @property
    def fitness(self) -> float | None:
        """The fitness of the trial; None if it was not driven to its end."""
        return self.progress.score if self.progress.phase is Phase.FINISHED else None

    def in_arena(self, pose: Array) -> Array:
        """Return a pose of the tracker (3,) relative to the task's origin, which is this pose until there is one."""
        return np.zeros_like(pose) if self.origin is None else self._task.system.relative_pose(self.origin, pose)

    def decide(self, tick: int, estimate: StateEstimate) -> Array | None:
        phase, keys = self.progress.phase, self._keyboard.keys
        self.newest_state = estimate.state
        if phase in (Phase.FINISHED, Phase.ENDED) or self._keyboard.new_trial_wanted:
            self.end()
            return None
        if phase is Phase.SETTLING:
            if self._rest.at_rest(estimate) and self._keyboard.all_released:
                self.progress = self._progress(Phase.READY)
            return self._task.system.neutral_control
        if phase is Phase.READY:
            if not keys:
                return self._task.system.neutral_control
            self._begin(tick, estimate)
        return self._drive(tick - self._began, estimate, keys)

    def end(self) -> None:
        """Mark the trial as over, unless it was driven to its end."""
        if self.progress.phase is not Phase.FINISHED:
            self.progress = self._progress(Phase.ENDED)

    def trajectory(self, name: str) -> Trajectory | None:
        """Return the driven trajectory relative to the task's origin; None without a step."""
        return self._tape.trajectory(self._task.system.dt, name) if len(self._tape.ticks) > 1 else None

    def _begin(self, tick: int, estimate: StateEstimate) -> None:
        self._began = tick
        if self.origin is None:
            self.origin = estimate.pose
        self.task_state = replace(self.task_state, pose=self.in_arena(estimate.pose)[None])

    def _drive(self, step: int, estimate: StateEstimate, keys: int) -> Array | None:
        """Return the control for ``step`` of the trial, or None if it is over."""
        pose, tape = self.in_arena(estimate.pose), self._tape
        if tape.states:
            self.task_state, _ = self._task.advance(
                self.task_state,
                tape.states[-1][None],
                estimate.state[None],
                control=tape.controls[-1][None],
                pose=pose[None],
            )
        tape.note(step, estimate.state, pose)
        if step >= self._task.horizon or not self.task_state.alive[0]:
            self.progress = self._progress(Phase.FINISHED)
            return None
        control = control_of_keys(keys, self._task.system)
        tape.controls.append(control)
        self.progress = self._progress(Phase.DRIVING)
        return control

    def _progress(self, phase: Phase) -> Reading:
        step, score = self._tape.ticks[-1] if self._tape.ticks else 0, float(self._task.fitness(self.task_state)[0])
        return Reading(phase=phase, step=step, score=score, waypoint=self._task.scene(self.task_state, 0).next_marker)


RATE_SPAN = 0.5  # s over which the rate of the tracker is measured


class HandPanel(Listener, DrivePanel):
    """A listener that keeps the newest data; another thread reads them with `reading`.

    Every attribute is replaced as a whole, so that a reader never gets half of a change.
    """

    def __init__(
        self, robot: Robot, task: Task, keyboard: Keyboard, *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        super().__init__(robot.name, task.bind(robot.system))
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
        """Show the ``score`` of the finished trial, if it has one, and a message."""
        self._message = message
        self._command = None
        if score is not None:
            self._scores = (*self._scores, score)

    def on_measurement(self, measurement: Measurement) -> None:
        now = self._clock()
        began, frames, rate = self._counted
        frames += measurement.valid
        span = now - began
        self._counted = (now, 0, frames / span) if span >= RATE_SPAN else (began, frames, rate)
        if measurement.valid:
            self._frame, self._arrived = measurement, now

    def on_command(self, command: Command) -> None:
        self._command = command

    def on_status(self, status: RobotStatus) -> None:
        self._status = status

    def scene(self) -> Scene:
        return Scene() if self._pilot is None else self.task.scene(self._pilot.task_state, 0)

    def reading(self) -> Reading:
        now, frame, command, status, pilot = self._clock(), self._frame, self._command, self._status, self._pilot
        age = now - self._arrived
        return replace(
            Reading(phase=Phase.ENDED) if pilot is None else pilot.progress,
            trial=self._number,
            scores=self._scores,
            state=None if pilot is None else pilot.newest_state,
            pose=None if frame is None or pilot is None else pilot.in_arena(frame.pose),
            control=None if command is None else command.control,
            keys=self._keyboard.keys & ALL_KEYS,
            tracker_age=round(age, 3) if math.isfinite(age) else None,
            tracker_rate=round(self._counted[2]),
            link=None if status is None else status.state,
            link_age=0.0 if status is None else round(now - status.time, 3),
            message=self._message,
        )


LEAD = 1.0  # s at rest before the first key, which the preparation of the log cuts off


class PreTriggerBuffer(Listener):
    """Passes events to ``listener`` from one second before ``pilot`` starts to drive.

    The wait for the first key, which may be long, is not recorded. ``make_listener`` is called once, when the driving
    begins: a trial without a key leaves no files.
    """

    def __init__(self, pilot: HumanPilot, make_listener: Callable[[], Listener]) -> None:
        self._pilot = pilot
        self._make = make_listener
        self._listener: Listener | None = None
        self._earlier: deque[tuple[float, Callable[[Listener], None]]] = deque()

    def on_measurement(self, measurement: Measurement) -> None:
        self._pass_on(measurement.arrival_time, lambda listener: listener.on_measurement(measurement))

    def on_command(self, command: Command) -> None:
        self._pass_on(command.time, lambda listener: listener.on_command(command))

    def on_status(self, status: RobotStatus) -> None:
        self._pass_on(status.time, lambda listener: listener.on_status(status))

    def close(self) -> None:
        if self._listener is not None:
            self._listener.close()

    def _pass_on(self, time: float, notify: Callable[[Listener], None]) -> None:
        if self._listener is not None:
            notify(self._listener)
            return
        self._earlier.append((time, notify))
        while self._earlier[0][0] < time - LEAD:
            self._earlier.popleft()
        if self._pilot.progress.phase is Phase.DRIVING:
            self._listener = self._make()
            for _, earlier in self._earlier:
                earlier(self._listener)
            self._earlier.clear()
