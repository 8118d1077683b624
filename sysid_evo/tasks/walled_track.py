"""Racing on a random track between walls, observed by distance sensors only."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, cast

import numpy as np

from sysid_evo.angles import TURN, wrap
from sysid_evo.errors import InvalidArgument
from sysid_evo.kernels import LANES, KernelSource, Layout, TaskKernel, view
from sysid_evo.registry.registry import register_task
from sysid_evo.system import Channel, System
from sysid_evo.tasks.task import Scene, Task, TaskState, planar_places
from sysid_evo.tasks.track_geometry import (
    LAST_STEP,
    MAX_RAY_STEPS,
    NUMBERS,
    TINY,
    at_offset,
    distance_to_wall,
    place_of,
    tracks_of,
    wall,
)
from sysid_evo.types import Array, IntArray, Seeds

COLLISIONS = ("slow", "end")

POTENTIAL = 0.1
"""Highest potential, in m: in the middle of the track and along it."""

SPEED_KEPT_AT_WALL = 0.5
"""Share of the speed that remains after each step at a wall."""
TOUCH_MARGIN = 1e-6
"""Depth (m) beyond its position at a wall at which a body counts as touching it; a body at rest there does not."""


@dataclass(frozen=True)
class WalledTrackState(TaskState):
    """``tracks`` (E, n) are the parameters of each trial's track, ``half`` its half width in m.

    ``progress`` (B,) m is the distance along the centre line, ``furthest`` (B,) its maximum, ``turned`` (B,) rad the
    angle around the centre, ``touches`` (B,) the number of steps at a wall.
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
    """Fitness is the distance (m) driven counter-clockwise along a closed track in ``horizon`` steps.

    Every trial draws a track of mean ``radius`` (m) and ``width`` (m); each of four harmonics adds up to ``bends`` /
    ``radius`` to its curvature. A trial begins at rest on the centre line, heading along it. A body of radius ``body``
    (m) that touches a wall is stopped there and loses half of its speed in each step (``collision="slow"``), or the
    trial is over ("end").

    | observation | unit |
    |---|---|
    | bias, always 1 | |
    | forward speed | m/s |
    | yaw rate | rad/s |
    | distance to the wall along each of ``rays`` rays over ``view`` rad, from right to left, at most ``reach`` | m |
    """

    fitness_unit = "m"
    rest_is_zero = True

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
        planar_places("walled_track", system)

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
        touching = np.abs(place.offset) > room + TOUCH_MARGIN
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
            slowed[:, row] *= np.where(touching, SPEED_KEPT_AT_WALL, 1.0)
        return replace(advanced, pose=stopped), slowed

    def fitness(self, task_state: TaskState) -> Array:
        return cast("WalledTrackState", task_state).furthest

    def hide_future(self, task_state: TaskState) -> WalledTrackState:
        """Return the trials with the present position as start; the track is known."""
        here = cast("WalledTrackState", task_state)
        return replace(here, furthest=here.progress)

    def potential(self, task_state: TaskState, state: Array) -> Array:
        """Return the potential (m): `POTENTIAL` in the middle of the track and along it, 0 at a wall or backwards."""
        here = cast("WalledTrackState", task_state)
        x, y, heading = here.pose.T
        place = place_of(here.track, x, y)
        along = np.cos(heading - np.arctan2(place.sine, place.cosine) - np.arctan2(place.middle, place.slope))
        return POTENTIAL * 0.5 * (1.0 + along) * np.maximum(0.0, 1.0 - (place.offset / here.half) ** 2)

    def measures(self, task_state: TaskState) -> Mapping[str, Array]:
        """Return the number of laps and of steps at a wall."""
        here = cast("WalledTrackState", task_state)
        return {"laps": here.turned / TURN, "steps at a wall": here.touches.astype(np.float64)}

    def scene(self, task_state: TaskState, trial: int) -> Scene:
        """Return both walls of one trial."""
        here = cast("WalledTrackState", task_state)
        walls = tuple(wall(here.track[trial], offset) for offset in (-here.half, here.half))
        return Scene(walls=walls, extent=float(np.abs(walls[1]).max()))

    def kernel(self) -> TaskKernel[Any] | None:
        motion = self.system.motion_kernel()
        if motion is None:
            return None
        forward, *lateral = self.speeds
        parameters = HEAD.pack(
            self.directions,
            motion.parameters,
            forward=forward,
            lateral=lateral[0] if lateral else -1,
            yaw_rate=self.yaw_rate,
            dt=self.system.dt,
            half=0.5 * self.width,
            room=0.5 * self.width - self.body,
            ends=self.collision == "end",
            reach=self.reach,
            rays=self.rays,
        )
        return TaskKernel(
            observe=KernelSource(observe_lanes),
            advance=KernelSource(advance_lanes, {"move": motion.move}),
            rows=_rows,
            trial_data=lambda task_state: np.zeros((len(task_state.alive), 1)),
            state=_state,
            parameters=parameters,
            pose_row=ROWS.x,
            n_pose=self.system.n_pose,
        )

    @property
    def speeds(self) -> tuple[int, ...]:
        """The indices of forward speed and, if there is one, lateral speed among the states."""
        places = planar_places("walled_track", self.system)
        return tuple(places[role] for role in ("forward", "lateral") if role in places)

    @property
    def yaw_rate(self) -> int:
        """The index of the yaw rate among the states."""
        return planar_places("walled_track", self.system)["yaw_rate"]


ROWS = Layout(
    "furthest", "alive", "x", "y", "heading", "progress", "turned", "touches",
    "first_x", "first_y", "way_x", "way_y", "offset", "rise_x", "rise_y", "moving", "track",
)  # fmt: skip
HEAD = Layout("forward", "lateral", "yaw_rate", "dt", "half", "room", "ends", "reach", "rays")


def _rows(here: WalledTrackState) -> Array:
    x, y, heading = here.pose.T
    rows = [here.furthest, here.alive, x, y, wrap(heading), here.progress, here.turned, here.touches]
    room = np.zeros((ROWS.track - len(rows), len(x)))
    track = here.track.T.copy()
    track[3:-2] *= track[2]  # a_k and b_k in m
    return np.stack([np.asarray(row, dtype=np.float64) for row in (*rows, *room, *track)])


def _state(here: WalledTrackState, rows: Array) -> TaskState:
    return replace(
        here,
        furthest=rows[ROWS.furthest],
        alive=rows[ROWS.alive] > 0,
        pose=rows[ROWS.x : ROWS.heading + 1].T.copy(),
        progress=rows[ROWS.progress],
        turned=rows[ROWS.turned],
        touches=rows[ROWS.touches].astype(np.int64),
    )


def observe_lanes(task, state, observation, parameters):
    """Bias, forward speed, yaw rate, and distance to the wall along each ray; all rays share their first step."""
    forward = view(state, int(parameters[HEAD.forward]) * LANES)
    yaw_rate = view(state, int(parameters[HEAD.yaw_rate]) * LANES)
    track, half, reach = view(task, ROWS.track * LANES), parameters[HEAD.half], parameters[HEAD.reach]
    xs, ys, headings = view(task, ROWS.x * LANES), view(task, ROWS.y * LANES), view(task, ROWS.heading * LANES)
    ways_x, ways_y = view(task, ROWS.way_x * LANES), view(task, ROWS.way_y * LANES)
    offsets, moving = view(task, ROWS.offset * LANES), view(task, ROWS.moving * LANES)
    rises_x, rises_y = view(task, ROWS.rise_x * LANES), view(task, ROWS.rise_y * LANES)
    least, greatest = view(track, (NUMBERS - 2) * LANES), view(track, (NUMBERS - 1) * LANES)
    for lane in range(LANES):
        observation[lane] = 1.0
        observation[LANES + lane] = forward[lane]
        observation[2 * LANES + lane] = yaw_rate[lane]
        offsets[lane], rises_x[lane], rises_y[lane] = level(track, lane, xs[lane], ys[lane])
    for ray in range(int(parameters[HEAD.rays])):
        gone, direction = view(observation, (3 + ray) * LANES), parameters[HEAD.size + ray]
        for lane in range(LANES):
            angle = headings[lane] + direction
            way_x, way_y = math.cos(angle), math.sin(angle)
            ways_x[lane], ways_y[lane] = way_x, way_y
            rise = rises_x[lane] * way_x + rises_y[lane] * way_y
            step = step_to_wall(offsets[lane], rise, half, least[lane], greatest[lane])
            gone[lane] = min(max(step, 0.0), reach)
            moving[lane] = 1.0 if gone[lane] > LAST_STEP else 0.0
        for _ in range(MAX_RAY_STEPS - 1):
            still_moving = 0
            for lane in range(LANES):
                still_moving += 1 if moving[lane] > 0.0 else 0
            if still_moving == 0:
                break
            for lane in range(LANES):
                way_x, way_y, far = ways_x[lane], ways_y[lane], gone[lane]
                offset, rise_x, rise_y = level(track, lane, xs[lane] + far * way_x, ys[lane] + far * way_y)
                rise = rise_x * way_x + rise_y * way_y
                step = step_to_wall(offset, rise, half, least[lane], greatest[lane])
                gone[lane] = min(max(far + step, 0.0), reach) if moving[lane] > 0.0 else far
                moving[lane] = 1.0 if abs(gone[lane] - far) > LAST_STEP else 0.0


def advance_lanes(task, before, after, control, trials, trial_data, parameters):
    """Move the pose, measure the distance, and stop at the walls."""
    room, ends = parameters[HEAD.room], parameters[HEAD.ends]
    xs, ys, track = view(task, ROWS.x * LANES), view(task, ROWS.y * LANES), view(task, ROWS.track * LANES)
    first_x, first_y = view(task, ROWS.first_x * LANES), view(task, ROWS.first_y * LANES)
    for lane in range(LANES):
        first_x[lane] = xs[lane] - track[lane]
        first_y[lane] = ys[lane] - track[LANES + lane]
    own = view(parameters, HEAD.size + int(parameters[HEAD.rays]))
    move(xs, before, after, parameters[HEAD.dt], own)
    forward, lateral = view(after, int(parameters[HEAD.forward]) * LANES), int(parameters[HEAD.lateral])
    sideways = view(after, max(lateral, 0) * LANES)
    for lane in range(LANES):
        dx, dy, x, y = first_x[lane], first_y[lane], xs[lane] - track[lane], ys[lane] - track[LANES + lane]
        turned = math.atan2(dx * y - dy * x, dx * x + dy * y)
        distance = math.sqrt(x * x + y * y) + TINY
        cosine, sine = x / distance, y / distance
        middle, slope, _ = centre_line(track, lane, cosine, sine)
        per_radian = math.sqrt(middle * middle + slope * slope)
        offset = (distance - middle) * middle / per_radian
        progress = task[ROWS.progress * LANES + lane] + turned * per_radian
        task[ROWS.progress * LANES + lane] = progress
        task[ROWS.turned * LANES + lane] += turned
        task[lane] = max(task[lane], progress)
        touching = 1.0 if abs(offset) > room + TOUCH_MARGIN else 0.0
        task[ROWS.touches * LANES + lane] += touching
        task[LANES + lane] = 0.0 if touching * ends > 0.0 else task[LANES + lane]
        stopped = touching * (1.0 - ends)
        stop = middle + min(max(offset, -room), room) * per_radian / middle
        xs[lane] = track[lane] + stop * cosine if stopped > 0.0 else xs[lane]
        ys[lane] = track[LANES + lane] + stop * sine if stopped > 0.0 else ys[lane]
        kept = SPEED_KEPT_AT_WALL if stopped > 0.0 else 1.0
        forward[lane] *= kept
        sideways[lane] *= kept if lateral >= 0 else 1.0


def level(track, lane, x, y):
    """Return the offset of one point and its derivatives with respect to x and y, as `Place`."""
    dx, dy = x - track[lane], y - track[LANES + lane]
    square = dx * dx + dy * dy + TINY * TINY
    inverse = 1.0 / math.sqrt(square)
    distance, cosine, sine = square * inverse, dx * inverse, dy * inverse
    middle, slope, bend = centre_line(track, lane, cosine, sine)
    along = 1.0 / math.sqrt(middle * middle + slope * slope)
    outwards, beyond = middle * along, distance - middle
    turned = slope * (slope * slope - middle * bend) * (along * along * along)
    across = (beyond * turned - slope * outwards) * inverse
    return beyond * outwards, outwards * cosine - across * sine, outwards * sine + across * cosine


def centre_line(track, lane, cosine, sine):
    """Return r, r' and r'' of the centre line in one direction."""
    c2, s2 = cosine * cosine - sine * sine, 2.0 * sine * cosine
    c3, s3 = c2 * cosine - s2 * sine, s2 * cosine + c2 * sine
    c4, s4 = c2 * c2 - s2 * s2, 2.0 * s2 * c2
    c5, s5 = c3 * c2 - s3 * s2, s3 * c2 + c3 * s2
    a2, b2, a3, b3 = track[3 * LANES + lane], track[4 * LANES + lane], track[5 * LANES + lane], track[6 * LANES + lane]
    a4, b4, a5, b5 = track[7 * LANES + lane], track[8 * LANES + lane], track[9 * LANES + lane], track[10 * LANES + lane]
    w2, w3, w4, w5 = a2 * c2 + b2 * s2, a3 * c3 + b3 * s3, a4 * c4 + b4 * s4, a5 * c5 + b5 * s5
    middle = track[2 * LANES + lane] + w2 + w3 + (w4 + w5)
    slope = (
        2.0 * (b2 * c2 - a2 * s2) + 3.0 * (b3 * c3 - a3 * s3) + 4.0 * (b4 * c4 - a4 * s4) + 5.0 * (b5 * c5 - a5 * s5)
    )
    return middle, slope, -(4.0 * w2 + 9.0 * w3 + (16.0 * w4 + 25.0 * w5))


def step_to_wall(offset, rise, half, least, greatest):
    """`sysid_evo.tasks.track_geometry.step_to_wall` of one point."""
    outer, inner = half - offset, half + offset
    lead, room = (1.0 + greatest * offset) * rise, outer * (2.0 + greatest * inner)
    out = max(lead + math.sqrt(max(lead * lead + greatest * room, 0.0)), TINY)
    lead_in, room_in = (1.0 + least * offset) * rise, inner * (2.0 - least * outer)
    root = lead_in * lead_in - least * room_in
    within = max(math.sqrt(max(root, 0.0)) - lead_in if root >= 0.0 else 0.0, TINY)
    sooner = room * within < room_in * out  # one division instead of two
    return (room if sooner else room_in) / (out if sooner else within)
