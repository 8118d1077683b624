"""Racing between walls over lanes, see `sysid_evo.tasks.walled_track` and `sysid_evo.tasks.track`."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import cast

import numpy as np

from sysid_evo import angles
from sysid_evo.arrays import Array
from sysid_evo.engine.compiled.dialect import KernelSource
from sysid_evo.engine.compiled.kernel import TaskKernel
from sysid_evo.engine.compiled.lanes import LANES, view
from sysid_evo.engine.compiled.layout import Layout
from sysid_evo.motion.compiled_form import motion_kernel
from sysid_evo.tasks.task import TaskState
from sysid_evo.tasks.track import CAREFUL, NUMBERS, WALK
from sysid_evo.tasks.walled_track import KEPT, WalledTrack, WalledTrackState

ROWS = Layout("furthest", "alive", "x", "y", "heading", "progress", "turned", "touches", "start_x", "start_y", "track")
HEAD = Layout("forward", "lateral", "yaw_rate", "dt", "half", "room", "ends", "reach", "rays")


def walled_track_kernel(task: WalledTrack) -> TaskKernel | None:
    """Return the compiled form of a bound task; None if its motion has none."""
    motion = motion_kernel(task.system)
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
    rows = [here.furthest, here.alive, x, y, angles.wrap(heading), here.progress, here.turned, here.touches, x, y]
    return np.stack([np.asarray(row, dtype=np.float64) for row in (*rows, *here.track.T)])


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
    """Bias, forward speed, yaw rate, and how far the wall is along each ray."""
    forward = view(state, int(parameters[HEAD.forward]) * LANES)
    yaw_rate = view(state, int(parameters[HEAD.yaw_rate]) * LANES)
    track, half, reach = view(task, ROWS.track * LANES), parameters[HEAD.half], parameters[HEAD.reach]
    xs, ys, headings = view(task, ROWS.x * LANES), view(task, ROWS.y * LANES), view(task, ROWS.heading * LANES)
    for lane in range(LANES):
        observation[lane] = 1.0
        observation[LANES + lane] = forward[lane]
        observation[2 * LANES + lane] = yaw_rate[lane]
    for ray in range(int(parameters[HEAD.rays])):
        gone, direction = view(observation, (3 + ray) * LANES), parameters[HEAD.size + ray]
        for lane in range(LANES):
            angle = headings[lane] + direction
            way_x, way_y, far = math.cos(angle), math.sin(angle), 0.0
            for _ in range(WALK):
                offset = place(track, lane, xs[lane] + far * way_x, ys[lane] + far * way_y)[5]
                far = min(far + CAREFUL * max(half - abs(offset), 0.0), reach)
            gone[lane] = far


def advance(task, before, after, control, trials, trial_data, parameters):
    """Let the motion move the pose, measure the way, and stop at the walls."""
    room, ends = parameters[HEAD.room], parameters[HEAD.ends]
    xs, ys, track = view(task, ROWS.x * LANES), view(task, ROWS.y * LANES), view(task, ROWS.track * LANES)
    start_x, start_y = view(task, ROWS.start_x * LANES), view(task, ROWS.start_y * LANES)
    for lane in range(LANES):
        start_x[lane] = xs[lane]
        start_y[lane] = ys[lane]
    own = view(parameters, HEAD.size + int(parameters[HEAD.rays]))
    move(xs, before, after, parameters[HEAD.dt], own)
    forward, lateral = view(after, int(parameters[HEAD.forward]) * LANES), int(parameters[HEAD.lateral])
    sideways = view(after, max(lateral, 0) * LANES)
    for lane in range(LANES):
        c0, s0, _, _, _, _ = place(track, lane, start_x[lane], start_y[lane])
        c, s, middle, _, per_radian, offset = place(track, lane, xs[lane], ys[lane])
        turned = math.atan2(c0 * s - s0 * c, c0 * c + s0 * s)
        progress = task[ROWS.progress * LANES + lane] + turned * per_radian
        task[ROWS.progress * LANES + lane] = progress
        task[ROWS.turned * LANES + lane] += turned
        task[lane] = max(task[lane], progress)
        touching = 1.0 if abs(offset) > room else 0.0
        task[ROWS.touches * LANES + lane] += touching
        task[LANES + lane] = 0.0 if touching * ends > 0.0 else task[LANES + lane]
        stopped = touching * (1.0 - ends)
        distance = middle + min(max(offset, -room), room) * per_radian / middle
        xs[lane] = track[lane] + distance * c if stopped > 0.0 else xs[lane]
        ys[lane] = track[LANES + lane] + distance * s if stopped > 0.0 else ys[lane]
        kept = KEPT if stopped > 0.0 else 1.0
        forward[lane] *= kept
        sideways[lane] *= kept if lateral >= 0 else 1.0


def place(track, lane, x, y):
    """`sysid_evo.tasks.track.place_of` one point: cosine, sine, r, r', length per radian, offset."""
    dx, dy = x - track[lane], y - track[LANES + lane]
    distance = math.sqrt(dx * dx + dy * dy) + 1e-9
    cosine, sine = dx / distance, dy / distance
    middle, slope, c, s = 1.0, 0.0, cosine, sine
    for i in range(4):
        c, s = c * cosine - s * sine, s * cosine + c * sine
        a, b = track[(3 + 2 * i) * LANES + lane], track[(4 + 2 * i) * LANES + lane]
        middle += a * c + b * s
        slope += float(i + 2) * (b * c - a * s)
    middle, slope = track[2 * LANES + lane] * middle, track[2 * LANES + lane] * slope
    per_radian = math.sqrt(middle * middle + slope * slope)
    return cosine, sine, middle, slope, per_radian, (distance - middle) * middle / per_radian
