"""Trials of a task on a robot, one after the other, as one pilot; the runner of the transfer matrix."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np

from hardware.connection import Listener
from hardware.control_loop import ControlLoop, Pilot, check_loop
from hardware.estimator import StateEstimate
from hardware.robot import Robot
from hardware.run_report import LoopReport, StopReason, StopRequest
from sysid_evo.controllers import Controller, View
from sysid_evo.data.trajectory import Trajectory
from sysid_evo.engine import Rollouts
from sysid_evo.engine.rollout import BoundRunner
from sysid_evo.errors import InvalidArgument
from sysid_evo.progress import Progress
from sysid_evo.randomness import CONTROLLER_STREAM, draw_for_steps
from sysid_evo.system import System
from sysid_evo.tasks.task import Task, TaskState
from sysid_evo.types import Array, Seeds, check_shape

ENGINE = "robot"
REST_TIME = 0.5  # s over which a robot at rest stays within
REST_DISTANCE = 0.01  # m and
REST_ANGLE = 0.06  # rad: a few times the errors of an optical tracker
REST_LIMIT = 10.0  # s by which it must have come to rest


class StandstillDetector:
    """Detects from the last poses whether a robot is at rest."""

    def __init__(self) -> None:
        self._seen: deque[tuple[float, Array]] = deque()

    def at_rest(self, estimate: StateEstimate) -> bool:
        """Take in the robot's pose; return whether it has not moved for half a second."""
        self._seen.append((estimate.time, estimate.pose))
        while len(self._seen) > 1 and self._seen[1][0] <= estimate.time - REST_TIME:
            self._seen.popleft()
        if self._seen[0][0] > estimate.time - REST_TIME:
            return False
        poses = np.array([pose for _, pose in self._seen])
        poses[:, 2] = np.unwrap(poses[:, 2])
        spread = np.ptp(poses, axis=0)
        return bool(max(spread[0], spread[1]) <= REST_DISTANCE and spread[2] <= REST_ANGLE)


@dataclass
class TrialLog:
    """Samples of one trial; some may be missing."""

    ticks: list[int] = field(default_factory=list)
    states: list[Array] = field(default_factory=list)
    poses: list[Array] = field(default_factory=list)
    controls: list[Array] = field(default_factory=list)

    def note(self, tick: int, state: Array, pose: Array) -> None:
        """Record the robot's state and pose at ``tick``; the control decided on then is appended to ``controls``."""
        self.ticks.append(tick)
        self.states.append(state)
        self.poses.append(pose)

    def trajectory(self, dt: float, name: str) -> Trajectory:
        """Return the trial at every sample; at a missing one states are interpolated, and the control is held."""
        grid = np.arange(self.ticks[-1] + 1)

        def filled(rows: Array) -> Array:
            return np.stack([np.interp(grid, self.ticks, column) for column in rows.T], axis=1)

        held = np.searchsorted(self.ticks[:-1], grid[:-1], side="right") - 1
        poses = np.array(self.poses)
        poses[:, 2] = np.unwrap(poses[:, 2])
        return Trajectory(filled(np.array(self.states)), np.array(self.controls)[held], dt, filled(poses), name)


class TrialSeries(Pilot):
    """Lets every candidate (P, n_parameters) drive a trial of every seed (E,), all candidates before the next seed.

    Before each trial the robot is in neutral until it is at rest; the trial starts at that pose. The task's origin is
    ``origin``, a pose of the tracker (3,), or the robot's at the first trial. If the controller's output is not a
    number, neither is the control, and the loop ends the run. ``on_decision`` is called with this object after every
    decision. ``states`` are the task states of the trials of each candidate, ``tapes`` their samples.
    """

    def __init__(
        self,
        controller: Controller,
        parameters: Array,
        task: Task,
        seeds: Seeds,
        *,
        origin: Array | None = None,
        progress: Progress | None = None,
        on_decision: Callable[[TrialSeries], None] | None = None,
    ) -> None:
        self.controller = controller
        self.parameters = parameters
        self.task = task
        self.system: System = task.system
        self.seeds = seeds
        self.origin = origin
        self.not_at_rest = False
        self.finished = 0
        self.tapes: list[TrialLog] = []
        self._progress = progress
        self._on_decision = on_decision
        began = task.begin(seeds)
        self.states = [began for _ in parameters]
        self._noise = draw_for_steps(seeds, task.horizon, controller.n_noise, CONTROLLER_STREAM)
        self._memory = np.zeros((len(parameters), len(seeds), controller.n_memory))
        self._began: int | None = None
        self._waiting_since = 0
        self._rest = StandstillDetector()

    @property
    def trials(self) -> int:
        return len(self.parameters) * len(self.seeds)

    def decide(self, tick: int, estimate: StateEstimate) -> Array | None:
        control = self._decide(tick, estimate)
        if self._on_decision is not None:
            self._on_decision(self)
        return control

    def _decide(self, tick: int, estimate: StateEstimate) -> Array | None:
        if self._began is None:
            if not self._rest.at_rest(estimate):
                if (tick - self._waiting_since) * self.system.dt > REST_LIMIT:
                    self.not_at_rest = True
                    return None
                return self.system.neutral_control
            if self.origin is None:
                self.origin = estimate.pose
            self._began = tick
            self.tapes.append(TrialLog())
        control = self._drive(tick - self._began, estimate)
        if control is not None:
            return control
        self.finished += 1
        if self._progress is not None:
            self._progress(self.finished, self.trials)
        if self.finished == self.trials:
            return None
        self._began, self._waiting_since, self._rest = None, tick, StandstillDetector()
        return self.system.neutral_control

    def _drive(self, step: int, estimate: StateEstimate) -> Array | None:
        """Return the control for ``step`` of the present trial, or None if it is over."""
        trial, candidate = divmod(self.finished, len(self.parameters))
        task, tape = self.task, self.tapes[-1]
        assert self.origin is not None
        state, pose = estimate.state, self.system.relative_pose(self.origin, estimate.pose)
        here = self.states[candidate]
        only = np.arange(len(self.seeds)) == trial
        if not tape.ticks:
            here = replace(here, pose=np.where(only[:, None], pose, here.pose))
        else:
            before, after, control, seen = (
                np.tile(row, (len(only), 1)) for row in (tape.states[-1], state, tape.controls[-1], pose)
            )
            moved, _ = task.advance(here, before, after, control=control, pose=seen)
            here = here.updated_where(moved, only)
        self.states[candidate] = here
        tape.note(step, state, pose)
        if not here.alive[trial] or step >= task.horizon:
            return None
        one, states = here.only(trial), state[None]
        noise = self._noise[None, [trial], step] if self.controller.n_noise else None
        view = View(task.observe(one, states)[None], states[None], one, noise)
        raw, memory = self.controller.act(self.parameters[[candidate]], self._memory[[candidate]][:, [trial]], view)
        self._memory[candidate, trial] = memory[0, 0]
        if not np.isfinite(raw).all():
            return np.full(self.system.nu, np.nan)
        control = self.system.actuate(raw[0, 0])
        tape.controls.append(control)
        return control

    def rollouts(self, why_missing: str) -> Rollouts:
        """Return the trials that every candidate finished; the others are missing for the given reason."""
        candidates = len(self.parameters)
        done = self.finished // candidates
        fitness = np.stack([self.task.fitness(state)[:done] for state in self.states])
        tapes = [self.tapes[trial * candidates + c] for c in range(candidates) for trial in range(done)]
        steps = np.array([tape.ticks[-1] for tape in tapes], dtype=np.int64).reshape(candidates, done)
        names = [f"candidate-{c}-trial-{trial}" for c in range(candidates) for trial in range(done)]
        return Rollouts(
            fitness=fitness,
            survived=steps,
            clipped=np.zeros_like(steps),
            task_state=_joined(self.states, done),
            engine=ENGINE,
            trajectories=tuple(
                tape.trajectory(self.system.dt, name) for tape, name in zip(tapes, names, strict=True) if tape.controls
            ),
            missing=(why_missing,) * (len(self.seeds) - done),
        )


def _joined(states: list[TaskState], done: int) -> TaskState:
    """Return the first ``done`` trials of every candidate, candidate first."""
    names = [item.name for item in fields(states[0]) if item.name not in states[0].shared]
    joined = {name: np.concatenate([getattr(state, name)[:done] for state in states]) for name in names}
    return replace(states[0], **joined)


@dataclass(frozen=True)
class RobotRunner:
    """Runs trials on ``robot`` one at a time, in one session of the control loop.

    The task's origin is the robot's pose at the first trial, or that of the tracker (``tracker_frame``). ``seed`` fixes
    the random draws of an emulated robot. A fault ends the session: the present trial and those after it are missing,
    never scored. ``on_decision`` is called after every decision.
    """

    robot: Robot
    tracker_frame: bool = False
    seed: int | None = None
    listeners: Sequence[Listener] = ()
    stop: StopRequest = field(default_factory=StopRequest)
    progress: Progress | None = None
    on_decision: Callable[[TrialSeries], None] | None = None

    def bind(self, controller: Controller, task: Task) -> BoundRunner:
        """Return a function that runs ``controller`` at ``task``, see `Runner` and `drive`."""
        bound = task.bind(self.robot.system)
        law = controller.bind_to(bound)

        def run(parameters: Array, seeds: Seeds, *, record: bool = False) -> Rollouts:  # noqa: ARG001  always recorded
            return self.drive(law, parameters, bound, seeds)[0]

        return run

    def drive(self, controller: Controller, parameters: Array, task: Task, seeds: Seeds) -> tuple[Rollouts, LoopReport]:
        """Run every candidate (P, n_parameters) in a trial of every seed (E,); also return the report of the loop.

        Raises `LinkLost` if the robot does not connect.
        """
        check_loop(self.robot.system)
        task = task.bind(self.robot.system)
        controller = controller.bind_to(task)
        parameters = check_shape("parameters", parameters, (None, controller.n_parameters))
        if len(seeds) < 1 or len(parameters) < 1:
            raise InvalidArgument("robot: expected at least one candidate and one trial seed, got none")
        origin = np.zeros(self.robot.system.n_pose) if self.tracker_frame else None
        series = TrialSeries(
            controller, parameters, task, seeds, origin=origin, progress=self.progress, on_decision=self.on_decision
        )
        with self.robot.connect(seed=self.seed) as connection:
            loop = ControlLoop(connection, self.robot.system, listeners=self.listeners, stop=self.stop)
            report = loop.run(series)
        if series.not_at_rest:
            report = replace(report, reason=StopReason.NOT_AT_REST, detail=f"it still moves after {REST_LIMIT:.0f} s")
        return series.rollouts(report.sentence), report
