"""Walled_track and duel: racing between walls, seen by distance sensors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, cast

import numpy as np

from sysid_evo import angles
from sysid_evo.angles import TURN
from sysid_evo.errors import IncompatibleTask, InvalidArgument
from sysid_evo.kernels import KernelSource, TaskKernel
from sysid_evo.registry.registry import register_task
from sysid_evo.system import Channel, System
from sysid_evo.tasks.kernels import HEAD, KEPT, PRESSED, ROWS, advance, observe
from sysid_evo.tasks.task import Scene, Task, TaskState
from sysid_evo.tasks.track_geometry import NUMBERS, at_offset, distance_to_wall, place_of, tracks_of, wall
from sysid_evo.types import Array, IntArray, Seeds

POSE = ("x", "y", "heading")

COLLISIONS = ("slow", "end")

AHEAD = 0.1
"""What a body that stands well promises, in m."""


@dataclass(frozen=True)
class WalledTrackState(TaskState):
    """``tracks`` (E, n) are the numbers of each trial's track, ``half`` its half width in m.

    ``progress`` (B,) m is how far the body came along the centre line, ``furthest`` (B,) the most of it;
    ``turned`` (B,) rad how far it came round the centre; ``touches`` (B,) the steps at a wall.
    """

    shared: ClassVar[frozenset[str]] = frozenset({"tracks", "half"})

    tracks: Array
    half: float
    trial: IntArray
    progress: Array
    furthest: Array
    turned: Array
    touches: IntArray

    @property
    def track(self) -> Array:
        """The track of each trial, (B, n)."""
        return self.tracks[self.trial]


@register_task("walled_track")
class WalledTrack(Task):
    """Fitness is how far (m) the body comes along a closed track in ``horizon`` steps.

    Every trial draws a track of mean ``radius`` (m) and ``width`` (m); ``bends`` says how curved it is at most: each of
    four harmonics adds up to ``bends`` / ``radius`` to the curvature. A trial begins at rest on the centre line, along
    it; counter-clockwise counts. A body of radius ``body`` (m) that touches a wall stays there and keeps half of its
    speed in each step (``collision="slow"``), or the trial is over ("end").

    | observation | unit |
    |---|---|
    | bias, always 1 | |
    | forward speed | m/s |
    | yaw rate | rad/s |
    | distance to the wall along each of ``rays`` rays over ``view`` rad, from right to left, at most ``reach`` | m |
    """

    fitness_unit = "m"

    def __init__(
        self,
        *,
        horizon: int = 500,
        radius: float = 1.6,
        width: float = 0.7,
        bends: float = 0.5,
        body: float = 0.07,
        collision: str = "slow",
        rays: int = 5,
        view: float = math.pi,
        reach: float = 2.0,
    ) -> None:
        if horizon < 1 or not 0.0 < 2.0 * body < width < radius or not 0.0 <= bends <= 1.0:
            raise InvalidArgument(
                "walled_track: expected horizon >= 1, 0 < 2 body < width < radius and bends from 0 to 1, got "
                f"{horizon}, body {body} m, width {width} m, radius {radius} m, bends {bends}"
            )
        if collision not in COLLISIONS or rays < 1 or not 0.0 <= view <= TURN or not reach > 0.0:
            raise InvalidArgument(
                f"walled_track: expected collision {' or '.join(COLLISIONS)}, rays >= 1, view from 0 to 2 pi rad and "
                f"reach > 0 m, got {collision!r}, {rays}, {view}, {reach}"
            )
        self.horizon, self.radius, self.width, self.bends, self.body = horizon, radius, width, bends, body
        self.collision, self.rays, self.view, self.reach = collision, rays, view, reach
        self.observations = (
            Channel("bias", neutral=1.0),
            Channel("forward_speed", "m/s"),
            Channel("yaw_rate", "rad/s"),
            *(Channel(f"ray_{i + 1}", "m", 0.0, reach) for i in range(rays)),
        )

    @property
    def directions(self) -> Array:
        """The angle of each ray from the heading, (rays,) rad."""
        return np.linspace(-0.5, 0.5, self.rays) * self.view if self.rays > 1 else np.zeros(1)

    def check_system(self, system: System) -> None:
        motion = system.motion
        if motion is None or motion.pose_names != POSE or not {"forward", "yaw_rate"} <= motion.roles().keys():
            raise IncompatibleTask(
                "walled_track needs a planar body (roles forward and yaw_rate); "
                f"{system.name or 'this system'} has {'no motion' if motion is None else motion.kind}"
            )

    def begin(self, seeds: Seeds) -> WalledTrackState:
        trials = len(seeds)
        return WalledTrackState(
            state=np.tile(self.system.neutral_state, (trials, 1)),
            pose=np.zeros((trials, 3)),
            alive=np.ones(trials, dtype=bool),
            tracks=tracks_of(tuple(seeds.tolist()), self.radius, self.bends),
            half=0.5 * self.width,
            trial=np.arange(trials),
            progress=np.zeros(trials),
            furthest=np.zeros(trials),
            turned=np.zeros(trials),
            touches=np.zeros(trials, dtype=np.int64),
        )

    def observe(self, task_state: TaskState, state: Array) -> Array:
        here = cast("WalledTrackState", task_state)
        x, y, heading = here.pose.T
        track = here.track
        seen = [
            distance_to_wall(track, x, y, heading + direction, here.half, self.reach) for direction in self.directions
        ]
        return np.stack([np.ones(len(state)), state[:, self.speeds[0]], state[:, self.yaw_rate], *seen], axis=1)

    def advance(
        self, task_state: TaskState, before: Array, after: Array, *, control: Array, pose: Array | None = None
    ) -> tuple[TaskState, Array]:
        here, tracked = cast("WalledTrackState", task_state), pose is not None
        moved = self.system.move(here.pose, before, after) if pose is None else pose
        track = here.track
        start, place = place_of(track, *here.pose[:, :2].T), place_of(track, *moved[:, :2].T)
        turned = np.arctan2(
            start.cosine * place.sine - start.sine * place.cosine, start.cosine * place.cosine + start.sine * place.sine
        )
        progress = here.progress + turned * place.per_radian
        room = here.half - self.body
        touching = np.abs(place.offset) > room + PRESSED
        advanced = replace(
            here,
            progress=progress,
            furthest=np.maximum(here.furthest, progress),
            turned=here.turned + turned,
            touches=here.touches + touching,
            pose=moved,
        )
        if self.collision == "end":
            return replace(advanced, alive=here.alive & ~touching), after
        if tracked or not touching.any():
            return advanced, after
        x, y = at_offset(track, place, np.clip(place.offset, -room, room))
        stopped = np.where(touching[:, None], np.stack([x, y, moved[:, 2]], axis=1), moved)
        slowed = after.copy()
        for row in self.speeds:
            slowed[:, row] *= np.where(touching, KEPT, 1.0)
        return replace(advanced, pose=stopped), slowed

    def fitness(self, task_state: TaskState) -> Array:
        return cast("WalledTrackState", task_state).furthest

    def foreseen(self, task_state: TaskState) -> WalledTrackState:
        """Return the trials as they stand, the track known; what was driven before does not count."""
        here = cast("WalledTrackState", task_state)
        return replace(here, furthest=here.progress)

    def promise(self, task_state: TaskState, state: Array) -> Array:
        """Return up to ``AHEAD`` (m): all of it in the middle of the track and along it, 0 at a wall or backwards."""
        here = cast("WalledTrackState", task_state)
        x, y, heading = here.pose.T
        place = place_of(here.track, x, y)
        along = np.cos(heading - np.arctan2(place.sine, place.cosine) - np.arctan2(place.middle, place.slope))
        return AHEAD * 0.5 * (1.0 + along) * np.maximum(0.0, 1.0 - (place.offset / here.half) ** 2)

    def measures(self, task_state: TaskState) -> Mapping[str, Array]:
        """Return the laps driven and the steps spent at a wall."""
        here = cast("WalledTrackState", task_state)
        return {"laps": here.turned / TURN, "steps at a wall": here.touches.astype(np.float64)}

    def scene(self, task_state: TaskState, trial: int) -> Scene:
        """Return both walls of one trial."""
        here = cast("WalledTrackState", task_state)
        walls = tuple(wall(here.track[trial], offset) for offset in (-here.half, here.half))
        return Scene(walls=walls, extent=float(np.abs(walls[1]).max()))

    def kernel(self) -> TaskKernel[Any] | None:
        return walled_track_kernel(self)

    @property
    def speeds(self) -> tuple[int, ...]:
        """Where forward speed and, if there is one, lateral speed stand among the states."""
        assert self.system.motion is not None
        roles, names = self.system.motion.roles(), self.system.state_names
        return tuple(names.index(roles[role]) for role in ("forward", "lateral") if role in roles)

    @property
    def yaw_rate(self) -> int:
        """Where the yaw rate stands among the states."""
        assert self.system.motion is not None
        return self.system.state_names.index(self.system.motion.roles()["yaw_rate"])


def walled_track_kernel(task: WalledTrack) -> TaskKernel[Any] | None:
    """Return the compiled form of a bound task; None if its motion has none."""
    motion = task.system.motion_kernel()
    if motion is None:
        return None
    forward, *lateral = task.speeds
    parameters = HEAD.pack(
        task.directions,
        motion.parameters,
        forward=forward,
        lateral=lateral[0] if lateral else -1,
        yaw_rate=task.yaw_rate,
        dt=task.system.dt,
        half=0.5 * task.width,
        room=0.5 * task.width - task.body,
        ends=task.collision == "end",
        reach=task.reach,
        rays=task.rays,
    )
    return TaskKernel(
        observe=KernelSource(observe),
        advance=KernelSource(advance, {"move": motion.move}),
        n_rows=ROWS.track + NUMBERS,
        rows=_rows,
        trial_data=lambda task_state: np.zeros((len(task_state.alive), 1)),
        state=_state,
        parameters=parameters,
        pose_row=ROWS.x,
        n_pose=task.system.n_pose,
    )


def _rows(task_state: TaskState) -> Array:
    here = cast("WalledTrackState", task_state)
    x, y, heading = here.pose.T
    rows = [here.furthest, here.alive, x, y, angles.wrap(heading), here.progress, here.turned, here.touches]
    room = np.zeros((ROWS.track - len(rows), len(x)))
    track = here.track.T.copy()
    track[3:-2] *= track[2]  # a_k and b_k in m
    return np.stack([np.asarray(row, dtype=np.float64) for row in (*rows, *room, *track)])


def _state(task_state: TaskState, rows: Array) -> TaskState:
    return replace(
        cast("WalledTrackState", task_state),
        furthest=rows[ROWS.furthest],
        alive=rows[ROWS.alive] > 0,
        pose=rows[ROWS.x : ROWS.heading + 1].T.copy(),
        progress=rows[ROWS.progress],
        turned=rows[ROWS.turned],
        touches=rows[ROWS.touches].astype(np.int64),
    )
