"""Point-to-point racing over lanes: the motion moves the pose, the next waypoint of its trial."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import cast

import numpy as np

from sysid_evo import angles
from sysid_evo.arrays import Array
from sysid_evo.engine.compiled.dialect import KernelSource
from sysid_evo.engine.compiled.kernel import TaskKernel
from sysid_evo.engine.compiled.lanes import LANES, first_lane, lanes_at_most, load, splat, view
from sysid_evo.engine.compiled.layout import Layout
from sysid_evo.motion.compiled_form import motion_kernel
from sysid_evo.motion.planar_body_kernel import wrap
from sysid_evo.system import System
from sysid_evo.tasks.point_to_point import PointToPointState
from sysid_evo.tasks.task import TaskState

ROWS = Layout("passed", "alive", "x", "y", "heading", "next_x", "next_y")
HEAD = Layout("forward", "yaw_rate", "dt", "radius_squared", "n_data")


def waypoints_kernel(system: System, waypoint_radius: float, n_waypoints: int) -> TaskKernel | None:
    """Return the compiled form of `PointToPoint` on ``system``; None if its motion has none."""
    motion = motion_kernel(system)
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
    for lane in range(LANES):
        dx = task[ROWS.next_x * LANES + lane] - task[ROWS.x * LANES + lane]
        dy = task[ROWS.next_y * LANES + lane] - task[ROWS.y * LANES + lane]
        observation[lane] = 1.0
        observation[LANES + lane] = forward[lane]
        observation[2 * LANES + lane] = yaw_rate[lane]
        observation[3 * LANES + lane] = wrap(math.atan2(dy, dx) - task[ROWS.heading * LANES + lane])
        observation[4 * LANES + lane] = math.sqrt(dx * dx + dy * dy)


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
        task[ROWS.passed * LANES + lane] += 1.0
        number = int(task[ROWS.passed * LANES + lane])
        place = trials[lane] * int(parameters[HEAD.n_data]) + 2 * number
        task[ROWS.next_x * LANES + lane] = trial_data[place]
        task[ROWS.next_y * LANES + lane] = trial_data[place + 1]
