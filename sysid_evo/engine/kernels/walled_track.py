"""Racing between walls over lanes, see `sysid_evo.tasks.walled_track` and `sysid_evo.tasks.track`."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, cast

import numpy as np

from sysid_evo import angles
from sysid_evo.arrays import Array
from sysid_evo.kernels import LANES, KernelSource, Layout, TaskKernel, view
from sysid_evo.tasks.task import TaskState
from sysid_evo.tasks.track import NOWHERE, NUMBERS, STILL, WALK
from sysid_evo.tasks.walled_track import KEPT, PRESSED, WalledTrack, WalledTrackState

ROWS = Layout(
    "furthest", "alive", "x", "y", "heading", "progress", "turned", "touches",
    "first_x", "first_y", "way_x", "way_y", "offset", "rise_x", "rise_y", "moving", "track",
)  # fmt: skip
HEAD = Layout("forward", "lateral", "yaw_rate", "dt", "half", "room", "ends", "reach", "rays")


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


def observe(task, state, observation, parameters):
    """Bias, forward speed, yaw rate, and how far the wall is along each ray; the first step is shared by all rays."""
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
            moving[lane] = 1.0 if gone[lane] > STILL else 0.0
        for _ in range(WALK - 1):
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
                moving[lane] = 1.0 if abs(gone[lane] - far) > STILL else 0.0


def advance(task, before, after, control, trials, trial_data, parameters):
    """Let the motion move the pose, measure the way, and stop at the walls."""
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
        distance = math.sqrt(x * x + y * y) + NOWHERE
        cosine, sine = x / distance, y / distance
        middle, slope, _ = centre_line(track, lane, cosine, sine)
        per_radian = math.sqrt(middle * middle + slope * slope)
        offset = (distance - middle) * middle / per_radian
        progress = task[ROWS.progress * LANES + lane] + turned * per_radian
        task[ROWS.progress * LANES + lane] = progress
        task[ROWS.turned * LANES + lane] += turned
        task[lane] = max(task[lane], progress)
        touching = 1.0 if abs(offset) > room + PRESSED else 0.0
        task[ROWS.touches * LANES + lane] += touching
        task[LANES + lane] = 0.0 if touching * ends > 0.0 else task[LANES + lane]
        stopped = touching * (1.0 - ends)
        stop = middle + min(max(offset, -room), room) * per_radian / middle
        xs[lane] = track[lane] + stop * cosine if stopped > 0.0 else xs[lane]
        ys[lane] = track[LANES + lane] + stop * sine if stopped > 0.0 else ys[lane]
        kept = KEPT if stopped > 0.0 else 1.0
        forward[lane] *= kept
        sideways[lane] *= kept if lateral >= 0 else 1.0


def level(track, lane, x, y):
    """Return the offset of one point, and how fast it grows along x and along y, as `sysid_evo.tasks.track.Place`."""
    dx, dy = x - track[lane], y - track[LANES + lane]
    square = dx * dx + dy * dy + NOWHERE * NOWHERE
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
    """`sysid_evo.tasks.track.step_to_wall` of one point."""
    outer, inner = half - offset, half + offset
    lead, room = (1.0 + greatest * offset) * rise, outer * (2.0 + greatest * inner)
    out = max(lead + math.sqrt(max(lead * lead + greatest * room, 0.0)), NOWHERE)
    lead_in, room_in = (1.0 + least * offset) * rise, inner * (2.0 - least * outer)
    root = lead_in * lead_in - least * room_in
    within = max(math.sqrt(max(root, 0.0)) - lead_in if root >= 0.0 else 0.0, NOWHERE)
    sooner = room * within < room_in * out  # one division instead of two
    return (room if sooner else room_in) / (out if sooner else within)
