"""Leading states along a reference over lanes, see `sysid_evo.tasks.following`."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, cast

import numpy as np

from sysid_evo.angles import TURN
from sysid_evo.arrays import Array
from sysid_evo.kernels import LANES, KernelSource, Layout, TaskKernel, nearest, view
from sysid_evo.system import System
from sysid_evo.tasks.following import SHOWN, Following, FollowingState, full_controls, scaling
from sysid_evo.tasks.goals import Goal
from sysid_evo.tasks.task import TaskState

ROWS = Layout("score", "alive", "step", "squared", "late", "reached", "beyond", "pose")
"""The pose is followed by the target of each channel now, and its first error."""
HEAD = Layout(
    "nx", "nu", "goals", "dt", "n_pose", "gain", "effort", "stride", "n_data", "of_goals", "of_nu", "of_motion"
)
STATE = Layout("turn", "centre", "scale")
GOAL = Layout("place", "period", "per_tolerance", "per_still", "turn", "scale", "end")
CONTROL = Layout("neutral", "full")
NEVER = 1e30


def following_kernel(task: Following) -> TaskKernel[Any] | None:
    """Return the compiled form of a bound task; None if the motion of its system has none."""
    system, goals = task.system, task.goals
    motion = system.motion_kernel()
    if motion is None:
        return None
    samples, m = task.horizon + 1 if task.changes else 1, len(goals)
    states = state_numbers(system)
    controls = np.zeros((0, CONTROL.size))
    if system.nu:
        controls = np.stack([system.neutral_control, full_controls(system)], axis=1)
    of_goals = HEAD.size + states.size
    of_nu = of_goals + m * GOAL.size
    parameters = HEAD.pack(
        states,
        np.array([_of_goal(goal) for goal in goals]),
        controls,
        motion.parameters,
        nx=system.nx,
        nu=system.nu,
        goals=m,
        dt=system.dt,
        n_pose=system.n_pose,
        gain=100.0 / task.horizon / (1.0 + task.effort),
        effort=task.effort,
        stride=m if task.changes else 0,
        n_data=samples * m,
        of_goals=of_goals,
        of_nu=of_nu,
        of_motion=of_nu + controls.size,
    )
    return TaskKernel(
        observe=KernelSource(observe),
        advance=KernelSource(advance, {"move": motion.move}),
        n_rows=ROWS.pose + system.n_pose + 2 * m,
        rows=_rows,
        trial_data=_targets,
        state=_state,
        parameters=parameters,
        pose_row=ROWS.pose,
        n_pose=system.n_pose,
    )


def state_numbers(system: System) -> Array:
    """Return how each state is shown, `STATE` after `STATE`."""
    return np.array([_of_state(system, i) for i in range(system.nx)])


def _of_state(system: System, place: int) -> Array:
    channel = system.states[place]
    centre, scale = scaling(channel)
    return STATE.pack(turn=TURN / channel.period if channel.period else 0.0, centre=centre, scale=scale)


def _of_goal(goal: Goal) -> Array:
    return GOAL.pack(
        place=goal.place,
        period=goal.period,
        per_tolerance=1.0 / goal.tolerance,
        per_still=1.0 / goal.still,
        turn=TURN / goal.period if goal.period else 0.0,
        scale=1.0 / (SHOWN * goal.tolerance),
        end=min(goal.end, NEVER),
    )


def _targets(task_state: TaskState) -> Array:
    reference = cast("FollowingState", task_state).reference
    return reference.reshape(len(reference), -1)


def _rows(task_state: TaskState) -> Array:
    here = cast("FollowingState", task_state)
    numbers = [here.score, here.alive, here.step, here.squared, here.late, here.reached, here.beyond]
    rows = [*numbers, *here.pose.T, *here.target.T, *here.first.T]
    return np.stack([np.asarray(row, dtype=np.float64) for row in rows])


def _state(task_state: TaskState, rows: Array) -> TaskState:
    here = cast("FollowingState", task_state)
    return replace(
        here,
        score=rows[ROWS.score],
        alive=rows[ROWS.alive] > 0,
        step=rows[ROWS.step].astype(np.int64),
        squared=rows[ROWS.squared],
        late=rows[ROWS.late].astype(np.int64),
        reached=rows[ROWS.reached] > 0,
        beyond=rows[ROWS.beyond],
        pose=rows[ROWS.pose : ROWS.pose + here.pose.shape[1]].T.copy(),
    )


def observe(task, state, observation, parameters):
    """Bias, states, errors; sine and cosine of what is periodic."""
    nx, goals = int(parameters[HEAD.nx]), int(parameters[HEAD.goals])
    targets = view(task, (ROWS.pose + int(parameters[HEAD.n_pose])) * LANES)
    for lane in range(LANES):
        observation[lane] = 1.0
    row = 1
    for i in range(nx):
        p, value = view(parameters, HEAD.size + i * STATE.size), view(state, i * LANES)
        first, second = view(observation, row * LANES), view(observation, (row + 1) * LANES)
        turn, centre, scale = p[STATE.turn], p[STATE.centre], p[STATE.scale]
        if turn > 0.0:
            for lane in range(LANES):
                first[lane] = math.sin(turn * value[lane])
                second[lane] = math.cos(turn * value[lane])
            row += 2
        else:
            for lane in range(LANES):
                first[lane] = (value[lane] - centre) * scale
            row += 1
    for i in range(goals):
        p = view(parameters, int(parameters[HEAD.of_goals]) + i * GOAL.size)
        value, target = view(state, int(p[GOAL.place]) * LANES), view(targets, i * LANES)
        first, second = view(observation, row * LANES), view(observation, (row + 1) * LANES)
        turn, scale = p[GOAL.turn], p[GOAL.scale]
        if turn > 0.0:
            for lane in range(LANES):
                first[lane] = math.sin(turn * (target[lane] - value[lane]))
                second[lane] = math.cos(turn * (target[lane] - value[lane]))
            row += 2
        else:
            for lane in range(LANES):
                first[lane] = (target[lane] - value[lane]) * scale
            row += 1


def advance(task, before, after, control, trials, trial_data, parameters):
    """Take the next target, and score how near the state is to it."""
    nu, goals, n_pose = int(parameters[HEAD.nu]), int(parameters[HEAD.goals]), int(parameters[HEAD.n_pose])
    gain, effort = parameters[HEAD.gain], parameters[HEAD.effort]
    pose, per_dt = view(task, ROWS.pose * LANES), 1.0 / parameters[HEAD.dt]
    targets, firsts = view(pose, n_pose * LANES), view(pose, (n_pose + goals) * LANES)
    move(pose, before, after, parameters[HEAD.dt], view(parameters, int(parameters[HEAD.of_motion])))
    step, stride, n_data = view(task, ROWS.step * LANES), int(parameters[HEAD.stride]), int(parameters[HEAD.n_data])
    late, reached, beyond = (
        view(task, ROWS.late * LANES),
        view(task, ROWS.reached * LANES),
        view(task, ROWS.beyond * LANES),
    )
    for lane in range(LANES):
        step[lane] += 1.0
    if stride > 0:
        for lane in range(LANES):
            place = trials[lane] * n_data + min(int(step[lane]) * stride, n_data - goals)
            for i in range(goals):
                targets[i * LANES + lane] = trial_data[place + i]
    for lane in range(LANES):
        squares, moving, off, past, over = 0.0, 0.0, 0.0, -NEVER, 0.0
        for i in range(goals):
            p = view(parameters, int(parameters[HEAD.of_goals]) + i * GOAL.size)
            now, period = after[int(p[GOAL.place]) * LANES + lane], p[GOAL.period]
            error, change = targets[i * LANES + lane] - now, now - before[int(p[GOAL.place]) * LANES + lane]
            error = nearest_way(error, period) if period > 0.0 else error
            change = nearest_way(change, period) if period > 0.0 else change
            rate = change * per_dt * p[GOAL.per_still]
            moving += rate * rate
            share, first = error * p[GOAL.per_tolerance], firsts[i * LANES + lane]
            squares += share * share
            off = 1.0 if abs(share) > 1.0 else off
            over = 1.0 if abs(error) > p[GOAL.end] else over
            way = (1.0 if first > 0.0 else 0.0) - (1.0 if first < 0.0 else 0.0)
            past = max(past, -way * share / max(abs(first) * p[GOAL.per_tolerance], 1.0))
        power = 0.0
        for j in range(nu):
            c = view(parameters, int(parameters[HEAD.of_nu]) + j * CONTROL.size)
            full = (control[j * LANES + lane] - c[CONTROL.neutral]) * c[CONTROL.full]
            power += full * full
        power = power / float(nu) if nu > 0 else 0.0
        task[lane] += gain * (1.0 / (1.0 + squares + moving) + effort * (1.0 - power))
        task[LANES + lane] = 0.0 if over > 0.0 else task[LANES + lane]
        task[ROWS.squared * LANES + lane] += squares
        late[lane] = step[lane] if off > 0.0 else late[lane]
        reached[lane] = 1.0 if off == 0.0 else reached[lane]
        beyond[lane] = max(beyond[lane], past) if reached[lane] > 0.0 else beyond[lane]


def nearest_way(error, period):
    """Return ``error`` within half a period of 0, as `sysid_evo.angles.wrap` does."""
    error = error - period * nearest(error / period)
    return error + period if error <= -0.5 * period else error
