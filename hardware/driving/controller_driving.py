"""A controller drives, shown on the page: its trials live, or a playback of simulated ones."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from hardware.driving.keyboard import Keyboard
from hardware.driving.page_messages import DrivePanel, Phase, Reading
from hardware.driving.server import PageAddress, served
from hardware.driving.trials import TrialSeries
from hardware.robot import Robot
from hardware.run_report import StopReason, StopRequest
from sysid_evo.data import Trajectory
from sysid_evo.engine import Rollouts
from sysid_evo.evolution import Champion
from sysid_evo.tasks import Scene, Task
from sysid_evo.tasks.task import make_task
from sysid_evo.types import Array, Seeds

LONGEST = 20.0
"""Longest time (s) of the playback of a trial: longer trials are played faster."""
PAUSE = 1.0
"""Pause (s) between two trials of a playback, to show the end of the first."""
POLL = 0.02  # s
LAST_LOOK = 0.3
"""Time (s) for which the page is still updated after the last trial."""


@contextmanager
def shown_live(
    robot: Robot, task: Task, name: str, address: PageAddress, *, stop: StopRequest, announce: Callable[[str], None]
) -> Iterator[Callable[[TrialSeries], None]]:
    """Serve the page of the controller ``name`` at ``task``; yields a function to call after every decision."""
    panel = ControllerPanel(robot.name, task.bind(robot.system), name)
    with watched(panel, address, stop=stop, announce=announce):
        yield lambda series: panel.show(*shown_of(series))


def play_back(
    champion: Champion,
    robot: Robot,
    seeds: Seeds,
    rollouts: Rollouts,
    address: PageAddress,
    *,
    announce: Callable[[str], None],
) -> StopReason | None:
    """Play back simulated trials on the page, in real time or faster; return the reason of a stop, if any."""
    task = make_task(champion.task).bind(robot.system)
    panel = ControllerPanel(robot.name, task, champion.name, playback_speed=playback_speed(task))
    with StopRequest() as stop, watched(panel, address, stop=stop, announce=announce):
        play(panel, task, seeds, rollouts.trajectories, rollouts.fitness[0], stop=stop)
    return stop.reason


@contextmanager
def watched(
    panel: ControllerPanel, address: PageAddress, *, stop: StopRequest, announce: Callable[[str], None]
) -> Iterator[None]:
    """Serve ``panel`` and wait until the page has been opened, or for a stop from outside."""
    with served(panel, Keyboard(life=1.0), address, stop=stop, announce=announce) as page:
        while page.seats.driver is None and stop.reason is None:
            time.sleep(POLL)
        yield
        if stop.reason is None:
            time.sleep(LAST_LOOK)


class ControllerPanel(DrivePanel):
    """Shows the newest reading that it was given; one thread writes it, another reads it."""

    _shown = Reading(), Scene()

    def show(self, reading: Reading, scene: Scene) -> None:
        """Show the state of a trial."""
        self._shown = reading, scene

    def reading(self) -> Reading:
        return self._shown[0]

    def scene(self) -> Scene:
        return self._shown[1]


def shown_of(series: TrialSeries) -> tuple[Reading, Scene]:
    """Return reading and scene of a robot's trial after a decision of ``series``, for its first candidate."""
    trial = min(series.finished // len(series.parameters), len(series.seeds) - 1)
    task_state = series.states[0]
    fitness = series.task.fitness(task_state).tolist()
    done = tuple(fitness[: series.finished // len(series.parameters)])
    scene = series.task.scene(task_state, trial)
    here = Reading(trial + 1, score=fitness[trial], scores=done, waypoint=scene.next_marker)
    if not series.tapes or len(series.tapes) <= series.finished < series.trials:
        return here, scene
    tape = series.tapes[-1]
    over = series.finished == series.trials
    driven = replace(
        here,
        phase=Phase.FINISHED if over else Phase.DRIVING,
        step=tape.ticks[-1],
        state=tape.states[-1],
        pose=tape.poses[-1],
        control=tape.controls[-1] if tape.controls and not over else None,
    )
    return driven, scene


def play(
    panel: ControllerPanel,
    task: Task,
    seeds: Seeds,
    trajectories: tuple[Trajectory, ...],
    scores: Array,
    *,
    stop: StopRequest,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> None:
    """Show simulated trials (E,) of the bound ``task`` one after the other, with ``scores`` (E,) at their ends.

    Score over time and targets are those of the task along the ``trajectories``. A stop ends it.
    """
    tick = task.system.dt / playback_speed(task)
    for trial, (trajectory, score) in enumerate(zip(trajectories, scores, strict=True)):
        began = clock()
        last, scene = None, task.scene(task.begin(seeds[trial : trial + 1]), 0)
        for reading in readings(task, seeds[trial : trial + 1], trajectory, trial + 1):
            while clock() < began + reading.step * tick:
                if stop.reason is not None:
                    return
                sleep(min(POLL, tick))
            last = replace(reading, scores=tuple(scores[:trial].tolist()))
            panel.show(last, scene)
        if last is not None:
            done = tuple(scores[: trial + 1].tolist())
            panel.show(replace(last, phase=Phase.FINISHED, score=float(score), scores=done, control=None), scene)
        until = clock() + PAUSE
        while clock() < until and trial + 1 < len(trajectories):
            if stop.reason is not None:
                return
            sleep(POLL)


def playback_speed(task: Task) -> float:
    """Return the ratio of playback speed to real time for trials of a bound ``task``."""
    return max(1.0, task.horizon * task.system.dt / LONGEST)


def readings(task: Task, seed: Seeds, trajectory: Trajectory, number: int) -> list[Reading]:
    """Return the reading at every sample of the ``trajectory`` of the trial of one ``seed``."""
    task_state = task.begin(seed)
    poses = np.zeros((len(trajectory.states), 0)) if trajectory.pose is None else trajectory.pose
    found = []
    for step, state in enumerate(trajectory.states):
        if step:
            task_state, _ = task.advance(
                task_state,
                trajectory.states[step - 1][None],
                state[None],
                control=trajectory.controls[step - 1][None],
                pose=poses[step][None] if poses.size else None,
            )
        score, waypoint = float(task.fitness(task_state)[0]), task.scene(task_state, 0).next_marker
        control = trajectory.controls[min(step, len(trajectory.controls) - 1)]
        found.append(Reading(number, Phase.DRIVING, step, score, (), state, poses[step], control, waypoint))
    return found
