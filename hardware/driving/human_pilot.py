"""A person as the pilot of one trial of a task."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from hardware.driving.keyboard import Keyboard, control_of
from hardware.loop.pilot import Estimate, Pilot
from hardware.loop.trials import RestWatch, Tape
from sysid_evo.arrays import Array
from sysid_evo.data import Trajectory
from sysid_evo.tasks import Task, TaskState


class Phase(Enum):
    """Where a trial stands."""

    SETTLING = "settling"
    READY = "ready"
    DRIVING = "driving"
    FINISHED = "finished"
    ENDED = "ended"


@dataclass(frozen=True)
class Progress:
    """How far a trial has come: ``steps`` driven, ``score`` so far, ``waypoint`` (2,) m if the task has one."""

    phase: Phase
    steps: int
    score: float
    waypoint: Array | None


class HumanPilot(Pilot):
    """Drives by the keys that are held, from the first key on, for the task's ``horizon`` samples.

    The trial is offered once the robot stands and all keys are released. ``task`` must be bound;
    its trial is that of ``seed``. The task's ``origin`` is a pose of the tracker (3,), or the robot's
    at the first key. ``progress`` and ``newest_state`` (nx,) may be read by any thread.
    """

    def __init__(self, keyboard: Keyboard, task: Task, *, seed: int, origin: Array | None = None) -> None:
        self.origin = origin
        self._keyboard = keyboard
        self._task = task
        self._state: TaskState = task.begin(np.array([seed], dtype=np.uint64))
        self._tape = Tape()
        self._rest = RestWatch()
        self._began = 0
        self.newest_state: Array | None = None
        self.progress = self._progress(Phase.SETTLING)

    @property
    def fitness(self) -> float | None:
        """The fitness of the trial; None if it was not driven to its end."""
        return self.progress.score if self.progress.phase is Phase.FINISHED else None

    @property
    def task_state(self) -> TaskState:
        """Where the trial stands."""
        return self._state

    def in_arena(self, pose: Array) -> Array:
        """Return a pose of the tracker (3,) as seen from the task's origin, which is here until there is one."""
        return np.zeros_like(pose) if self.origin is None else self._task.system.seen_from(self.origin, pose)

    def decide(self, tick: int, estimate: Estimate) -> Array | None:
        phase, keys = self.progress.phase, self._keyboard.keys
        self.newest_state = estimate.state
        if phase in (Phase.FINISHED, Phase.ENDED) or self._keyboard.new_trial_wanted:
            self.end()
            return None
        if phase is Phase.SETTLING:
            if self._rest.at_rest(estimate) and self._keyboard.let_go:
                self.progress = self._progress(Phase.READY)
            return self._task.system.neutral_control
        if phase is Phase.READY:
            if not keys:
                return self._task.system.neutral_control
            self._begin(tick, estimate)
        return self._drive(tick - self._began, estimate, keys)

    def end(self) -> None:
        """Note that the trial is over, unless it was driven to its end."""
        if self.progress.phase is not Phase.FINISHED:
            self.progress = self._progress(Phase.ENDED)

    def trajectory(self, name: str) -> Trajectory | None:
        """Return what was driven, as seen from the task's origin; None without a step."""
        return self._tape.trajectory(self._task.system.dt, name) if len(self._tape.ticks) > 1 else None

    def _begin(self, tick: int, estimate: Estimate) -> None:
        self._began = tick
        if self.origin is None:
            self.origin = estimate.pose
        self._state = replace(self._state, pose=self.in_arena(estimate.pose)[None])

    def _drive(self, step: int, estimate: Estimate, keys: int) -> Array | None:
        """Return the control for ``step`` of the trial, or None if it is over."""
        pose, tape = self.in_arena(estimate.pose), self._tape
        if tape.states:
            self._state, _ = self._task.advance(
                self._state,
                tape.states[-1][None],
                estimate.state[None],
                control=tape.controls[-1][None],
                pose=pose[None],
            )
        tape.note(step, estimate.state, pose)
        if step >= self._task.horizon or not self._state.alive[0]:
            self.progress = self._progress(Phase.FINISHED)
            return None
        control = control_of(keys, self._task.system)
        tape.controls.append(control)
        self.progress = self._progress(Phase.DRIVING)
        return control

    def _progress(self, phase: Phase) -> Progress:
        return Progress(
            phase=phase,
            steps=self._tape.ticks[-1] if self._tape.ticks else 0,
            score=float(self._task.fitness(self._state)[0]),
            waypoint=self._task.scene(self._state, 0).next_marker,
        )
