"""A controller drives, shown on the page: its trials as they happen, or those of a simulation played back."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hardware.driving.keyboard import Keyboard
from hardware.driving.page_messages import first_scene, numbers, scenery_of, setting_of, speed_of, traced
from hardware.driving.server import PageAddress, served
from hardware.driving.trials import TrialSeries
from hardware.robot import Robot
from hardware.run_report import Reason, Stops
from sysid_evo.data import Trajectory
from sysid_evo.engine import Rollouts
from sysid_evo.evolution import Champion
from sysid_evo.system import System
from sysid_evo.tasks import Scene, Task
from sysid_evo.tasks.task import make_task
from sysid_evo.types import Array, Seeds

LONGEST = 20.0
"""Seconds that a trial played back may take: one of a slow process is played faster."""
PAUSE = 1.0
"""Seconds between two trials played back, to see how one ended."""
POLL = 0.02  # s
LAST_LOOK = 0.3
"""Seconds for which the page still hears how the last trial ended."""

SETTLING, CONTROLLED, FINISHED = "settling", "controlled", "finished"


@contextmanager
def shown_live(
    robot: Robot, task: Task, name: str, address: PageAddress, *, stops: Stops, announce: Callable[[str], None]
) -> Iterator[Callable[[TrialSeries], None]]:
    """Serve the page of the controller ``name`` at ``task``; gives what is to be called after every decision."""
    panel = ControllerPanel(robot.name, task.bind(robot.system), name)
    with watched(panel, address, stops=stops, announce=announce):
        yield lambda series: panel.show(moment_of(series))


def play_back(
    champion: Champion,
    robot: Robot,
    seeds: Seeds,
    rollouts: Rollouts,
    address: PageAddress,
    *,
    announce: Callable[[str], None],
) -> Reason | None:
    """Show trials that were simulated on the page, as fast as they went or faster; return what stopped that, if any."""
    task = make_task(champion.task).bind(robot.system)
    panel = ControllerPanel(robot.name, task, champion.name, faster=pace(task))
    with Stops() as stops, watched(panel, address, stops=stops, announce=announce):
        play(panel, task, seeds, rollouts.trajectories, rollouts.fitness[0], stops=stops)
    return stops.reason


@contextmanager
def watched(
    panel: ControllerPanel, address: PageAddress, *, stops: Stops, announce: Callable[[str], None]
) -> Iterator[None]:
    """Serve ``panel`` and wait until somebody has opened the page, or a stop from outside."""
    with served(panel, Keyboard(life=1.0), address, stops=stops, announce=announce) as page:
        while page.seats.driver is None and stops.reason is None:
            time.sleep(POLL)
        yield
        if stops.reason is None:
            time.sleep(LAST_LOOK)


class ControllerPanel:
    """Shows the newest `Moment`; one thread gives it, another reads it.

    ``name`` is who drives, ``faster`` how many times as fast as in the world.
    """

    def __init__(self, robot: str, task: Task, name: str, *, faster: float = 1.0) -> None:
        self._robot, self._task, self._name, self._faster = robot, task, name, faster
        self._system: System = task.system
        self._places = list(traced(self._system, first_scene(task)))
        self._moment = Moment()

    def show(self, moment: Moment) -> None:
        """Show where a trial stands."""
        self._moment = moment

    def setting(self) -> dict[str, Any]:
        setting = setting_of(self._robot, self._task, by_hand=False)
        return {**setting, "controller": self._name, "faster": self._faster}

    def scenery(self) -> dict[str, Any]:
        return scenery_of(self._system, self._moment.scene)

    def reading(self) -> dict[str, Any]:
        now = self._moment
        waypoint = now.scene.next_marker
        return {
            "trial": now.number,
            "step": now.step,
            "phase": now.phase,
            "time_left": (self._task.horizon - now.step) * self._system.dt,
            "score": now.score,
            "scores": list(now.scores),
            "waypoint": None if waypoint is None else waypoint.tolist(),
            "pose": None if now.pose is None or not now.pose.size else numbers(now.pose),
            "speed": speed_of(self._system, now.state),
            "state": None if now.state is None else numbers(now.state[self._places]),
            "control": None if now.control is None else numbers(now.control),
            "keys": 0,
            "tracker": None,
            "link": None,
            "message": "",
        }


@dataclass(frozen=True)
class Moment:
    """Where the trial ``number`` stands at ``step``: ``state`` (nx,), ``pose`` in the arena, ``control`` in force.

    ``scores`` are those of the trials that are over.
    """

    number: int = 0
    phase: str = SETTLING
    step: int = 0
    score: float = 0.0
    scores: tuple[float, ...] = ()
    state: Array | None = None
    pose: Array | None = None
    control: Array | None = None
    scene: Scene = field(default_factory=Scene)


def moment_of(series: TrialSeries) -> Moment:
    """Return where a robot's trial stands, after a decision of ``series``; its first candidate is shown."""
    trial = min(series.finished // len(series.parameters), len(series.seeds) - 1)
    task_state = series.states[0]
    fitness = series.task.fitness(task_state).tolist()
    done = tuple(fitness[: series.finished // len(series.parameters)])
    here = Moment(trial + 1, score=fitness[trial], scores=done, scene=series.task.scene(task_state, trial))
    if not series.tapes or len(series.tapes) <= series.finished < series.trials:
        return here
    tape = series.tapes[-1]
    over = series.finished == series.trials
    control = tape.controls[-1] if tape.controls and not over else None
    return replace(
        here,
        phase=FINISHED if over else CONTROLLED,
        step=tape.ticks[-1],
        state=tape.states[-1],
        pose=tape.poses[-1],
        control=control,
    )


def play(
    panel: ControllerPanel,
    task: Task,
    seeds: Seeds,
    trajectories: tuple[Trajectory, ...],
    scores: Array,
    *,
    stops: Stops,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> None:
    """Show trials (E,) of the bound ``task`` that were simulated, one after the other, ``scores`` (E,) at their ends.

    The course of the score and the targets are those of the task along the ``trajectories``. A stop ends it.
    """
    tick = task.system.dt / pace(task)
    for trial, (trajectory, score) in enumerate(zip(trajectories, scores, strict=True)):
        began = clock()
        last = None
        for moment in moments(task, seeds[trial : trial + 1], trajectory, trial + 1):
            while clock() < began + moment.step * tick:
                if stops.reason is not None:
                    return
                sleep(min(POLL, tick))
            last = replace(moment, scores=tuple(scores[:trial].tolist()))
            panel.show(last)
        if last is not None:
            done = tuple(scores[: trial + 1].tolist())
            panel.show(replace(last, phase=FINISHED, score=float(score), scores=done, control=None))
        until = clock() + PAUSE
        while clock() < until and trial + 1 < len(trajectories):
            if stops.reason is not None:
                return
            sleep(POLL)


def pace(task: Task) -> float:
    """Return how many times as fast as in the world the trials of a bound ``task`` are played back."""
    return max(1.0, task.horizon * task.system.dt / LONGEST)


def moments(task: Task, seed: Seeds, trajectory: Trajectory, number: int) -> list[Moment]:
    """Return where the trial of one ``seed`` stood at every sample of its ``trajectory``."""
    task_state = task.begin(seed)
    scene = task.scene(task_state, 0)
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
            if poses.size:
                scene = task.scene(task_state, 0)
        control = trajectory.controls[min(step, len(trajectory.controls) - 1)]
        shown = Moment(number, CONTROLLED, step, float(task.fitness(task_state)[0]), scene=scene)
        found.append(replace(shown, state=state, pose=poses[step], control=control))
    return found
