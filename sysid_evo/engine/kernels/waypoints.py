"""Point-to-point racing over lanes: the motion moves the pose, the next waypoint of its trial."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, cast

import numpy as np

from sysid_evo import angles
from sysid_evo.arrays import Array
from sysid_evo.kernels import (
    LANES,
    QUARTER,
    KernelSource,
    Layout,
    TaskKernel,
    first_lane,
    lanes_at_most,
    load,
    load_quarter,
    splat,
    splat_quarter,
    store,
    view,
    where_bits,
)
from sysid_evo.motion_kernels import wrap
from sysid_evo.system import System
from sysid_evo.tasks.point_to_point import PointToPointState
from sysid_evo.tasks.task import TaskState

ROWS = Layout("passed", "alive", "x", "y", "heading", "next_x", "next_y")
HEAD = Layout("forward", "yaw_rate", "dt", "radius_squared", "n_data")


def waypoints_kernel(system: System, waypoint_radius: float, n_waypoints: int) -> TaskKernel[Any] | None:
    """Return the compiled form of `PointToPoint` on ``system``; None if its motion has none."""
    motion = system.motion_kernel()
    if motion is None or system.motion is None:
        return None
    roles = system.motion.roles()
    parameters = HEAD.pack(
        motion.parameters,
        forward=system.state_names.index(roles["forward"]),
        yaw_rate=system.state_names.index(roles["yaw_rate"]),
        dt=system.dt,
        radius_squared=waypoint_radius**2,
        n_data=2 * n_waypoints,
    )
    return TaskKernel(
        observe=KernelSource(observe),
        advance=KernelSource(advance, {"move": motion.move}),
        n_rows=ROWS.size,
        rows=_rows,
        trial_data=_data,
        state=_state,
        parameters=parameters,
        pose_row=ROWS.x,
        n_pose=system.n_pose,
    )


def _data(task_state: TaskState) -> Array:
    waypoints = cast("PointToPointState", task_state).waypoints
    return waypoints.reshape(len(waypoints), -1)


def _rows(task_state: TaskState) -> Array:
    here = cast("PointToPointState", task_state)
    x, y, heading = here.pose.T
    rows = [here.passed, here.alive, x, y, angles.wrap(heading), *here.waypoint.T]  # wrapped while still exact
    return np.stack([np.asarray(row, dtype=np.float64) for row in rows])


def _state(task_state: TaskState, rows: Array) -> TaskState:
    passed = rows[ROWS.passed].astype(np.int64)
    return replace(
        cast("PointToPointState", task_state),
        passed=passed,
        alive=rows[ROWS.alive] > 0,
        pose=rows[ROWS.x : ROWS.heading + 1].T.copy(),
    )


def observe(task, state, observation, parameters):
    """Bias, forward speed, yaw rate, angle and distance to the waypoint."""
    forward = view(state, int(parameters[HEAD.forward]) * LANES)
    yaw_rate = view(state, int(parameters[HEAD.yaw_rate]) * LANES)
    store(observation, 0, splat(1.0))
    store(observation, LANES, load(forward, 0))
    store(observation, 2 * LANES, load(yaw_rate, 0))
    for lane in range(0, LANES, QUARTER):
        here, seen = view(task, lane), view(observation, lane)
        dx = load_quarter(here, ROWS.next_x * LANES) - load_quarter(here, ROWS.x * LANES)
        dy = load_quarter(here, ROWS.next_y * LANES) - load_quarter(here, ROWS.y * LANES)
        store(seen, 3 * LANES, wrap(math.atan2(dy, dx) - load_quarter(here, ROWS.heading * LANES)))
        store(seen, 4 * LANES, math.sqrt(dx * dx + dy * dy))


def advance(task, before, after, control, trials, trial_data, parameters):
    """Let the motion move the pose, and pass the waypoints within reach."""
    reach = parameters[HEAD.radius_squared]
    move(view(task, ROWS.x * LANES), before, after, parameters[HEAD.dt], view(parameters, HEAD.size))
    dx = load(task, ROWS.next_x * LANES) - load(task, ROWS.x * LANES)
    dy = load(task, ROWS.next_y * LANES) - load(task, ROWS.y * LANES)
    passing = lanes_at_most(dx * dx + dy * dy, splat(reach))
    while passing != 0:
        lane = first_lane(passing)
        passing &= passing - 1
        number = task[ROWS.passed * LANES + lane] + 1.0
        place = trials[lane] * int(parameters[HEAD.n_data]) + 2 * int(number)
        put(view(task, ROWS.passed * LANES), lane, number)
        put(view(task, ROWS.next_x * LANES), lane, trial_data[place])
        put(view(task, ROWS.next_y * LANES), lane, trial_data[place + 1])


def put(row, lane, number):
    """Write one lane of a row by way of its quarter: a row read soon after a single number was written waits for it."""
    first = lane - lane % QUARTER
    store(row, first, where_bits(1 << (lane % QUARTER), splat_quarter(number), load_quarter(row, first)))
