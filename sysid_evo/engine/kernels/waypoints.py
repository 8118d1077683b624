"""Point-to-point racing over lanes: a planar body's pose, and the next waypoint of its trial."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import cast

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.engine.compiled.dialect import KernelSource
from sysid_evo.engine.compiled.kernel import TaskKernel
from sysid_evo.engine.compiled.lanes import LANES, view
from sysid_evo.motion import PlanarBody
from sysid_evo.system import System
from sysid_evo.tasks.point_to_point import PointToPointState
from sysid_evo.tasks.task import TaskState

PASSED, ALIVE, X, Y, HEADING, NEXT_X, NEXT_Y, N_ROWS = range(8)
FORWARD, LATERAL, YAW_RATE, DT, RADIUS_SQUARED, N_DATA = range(6)
TURN = 2.0 * math.pi


def waypoints_kernel(system: System, waypoint_radius: float, n_waypoints: int) -> TaskKernel:
    """Return the compiled form of `PointToPoint` on ``system``, a planar body."""
    motion = cast("PlanarBody", system.motion)
    forward, lateral, yaw_rate = motion.indices(system.state_names)
    parameters = [forward, -1 if lateral is None else lateral, yaw_rate, system.dt, waypoint_radius**2, 2 * n_waypoints]
    return TaskKernel(
        observe=KernelSource(observe),
        advance=KernelSource(advance),
        n_rows=N_ROWS,
        rows=_rows,
        trial_data=lambda task_state: cast("PointToPointState", task_state).waypoints.reshape(
            len(task_state.alive), -1
        ),
        state=_state,
        parameters=np.array(parameters, dtype=np.float64),
        pose_row=X,
        n_pose=motion.n_pose,
    )


def _rows(task_state: TaskState) -> Array:
    here = cast("PointToPointState", task_state)
    rows = [here.passed, here.alive, *here.pose.T, *here.waypoint.T]
    return np.stack([np.asarray(row, dtype=np.float64) for row in rows])


def _state(task_state: TaskState, rows: Array) -> TaskState:
    passed = rows[PASSED].astype(np.int64)
    return replace(
        cast("PointToPointState", task_state), passed=passed, alive=rows[ALIVE] > 0, pose=rows[X : HEADING + 1].T.copy()
    )


def observe(task, state, observation, parameters):
    """Bias, forward speed, yaw rate, angle and distance to the waypoint."""
    forward = view(state, int(parameters[FORWARD]) * LANES)
    yaw_rate = view(state, int(parameters[YAW_RATE]) * LANES)
    for lane in range(LANES):
        dx = task[NEXT_X * LANES + lane] - task[X * LANES + lane]
        dy = task[NEXT_Y * LANES + lane] - task[Y * LANES + lane]
        observation[lane] = 1.0
        observation[LANES + lane] = forward[lane]
        observation[2 * LANES + lane] = yaw_rate[lane]
        observation[3 * LANES + lane] = wrap(math.atan2(dy, dx) - task[HEADING * LANES + lane])
        observation[4 * LANES + lane] = math.sqrt(dx * dx + dy * dy)


def advance(task, before, after, trials, trial_data, parameters):
    """Move the pose as `PlanarBody.move` does, and pass the waypoints within reach."""
    dt, reach = parameters[DT], parameters[RADIUS_SQUARED]
    forward, yaw_rate = int(parameters[FORWARD]) * LANES, int(parameters[YAW_RATE]) * LANES
    lateral = int(parameters[LATERAL]) * LANES
    sideways = 0.5 * dt if lateral >= 0 else 0.0
    u0, u1, r0, r1 = view(before, forward), view(after, forward), view(before, yaw_rate), view(after, yaw_rate)
    v0, v1 = view(before, max(lateral, 0)), view(after, max(lateral, 0))
    passes = 0
    for lane in range(LANES):
        turn = 0.5 * dt * (r0[lane] + r1[lane])
        along, across = 0.5 * dt * (u0[lane] + u1[lane]), sideways * (v0[lane] + v1[lane])
        middle = task[HEADING * LANES + lane] + 0.5 * turn
        c, s = math.cos(middle), math.sin(middle)
        x = task[X * LANES + lane] + (c * along - s * across)
        y = task[Y * LANES + lane] + (s * along + c * across)
        task[X * LANES + lane] = x
        task[Y * LANES + lane] = y
        task[HEADING * LANES + lane] = wrap(task[HEADING * LANES + lane] + turn)
        dx, dy = task[NEXT_X * LANES + lane] - x, task[NEXT_Y * LANES + lane] - y
        passes += 1 if dx * dx + dy * dy <= reach else 0
    if passes > 0:
        for lane in range(LANES):
            dx = task[NEXT_X * LANES + lane] - task[X * LANES + lane]
            dy = task[NEXT_Y * LANES + lane] - task[Y * LANES + lane]
            if dx * dx + dy * dy <= reach:
                task[PASSED * LANES + lane] += 1.0
                place = trials[lane] * int(parameters[N_DATA]) + 2 * int(task[PASSED * LANES + lane])
                task[NEXT_X * LANES + lane] = trial_data[place]
                task[NEXT_Y * LANES + lane] = trial_data[place + 1]


def wrap(angle):
    """Return an angle within two turns as the same one in (-pi, pi]."""
    angle = angle - TURN if angle > math.pi else angle
    return angle + TURN if angle <= -math.pi else angle
