"""A reward function over lanes, see `sysid_evo.tasks.reward`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, cast

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.engine.kernels.following import HEAD as OBSERVED
from sysid_evo.engine.kernels.following import observe, state_numbers
from sysid_evo.kernels import LANES, KernelSource, Layout, Source, TaskKernel, view
from sysid_evo.system import System
from sysid_evo.tasks.reward import RewardState
from sysid_evo.tasks.task import TaskState

ROWS = Layout("score", "alive", "pose")
"""After the pose comes one row in which the state and control of a lane stand side by side."""
OWN = Layout("lowest", "share")


def reward_kernel(
    system: System,
    scalar: Callable[..., Any] | Source,
    lowest: float,
    horizon: int,
    over: Source | None = None,
) -> TaskKernel[Any] | None:
    """Return the compiled form; None if the motion has none, or state and control fill more than a row.

    ``scalar`` and ``over`` are functions of one state and control; a trial is over where the latter is not 0.
    """
    motion = system.motion_kernel()
    if motion is None or system.nx + system.nu > LANES:
        return None
    worth = KernelSource(scalar) if callable(scalar) else scalar
    states = state_numbers(system)
    own = OBSERVED.size + states.size
    parameters = OBSERVED.pack(
        states,
        OWN.pack(lowest=lowest, share=1.0 / horizon),
        motion.parameters,
        nx=system.nx,
        nu=system.nu,
        goals=0,
        dt=system.dt,
        n_pose=system.n_pose,
        gain=0.0,
        effort=0.0,
        stride=0,
        n_data=0,
        of_goals=own,
        of_nu=own,
        of_motion=own + OWN.size,
    )
    return TaskKernel(
        observe=KernelSource(observe),
        advance=KernelSource(advance, {"move": motion.move, "worth": worth, "over": over or KernelSource(never)}),
        n_rows=ROWS.pose + system.n_pose + 1,
        rows=_rows,
        trial_data=lambda task_state: np.zeros((len(task_state.alive), 1)),
        state=_state,
        parameters=parameters,
        pose_row=ROWS.pose,
        n_pose=system.n_pose,
    )


def _rows(task_state: TaskState) -> Array:
    here = cast("RewardState", task_state)
    return np.stack([here.score, here.alive.astype(np.float64), *here.pose.T, np.zeros(len(here.alive))])


def _state(task_state: TaskState, rows: Array) -> TaskState:
    here = cast("RewardState", task_state)
    pose = rows[ROWS.pose : ROWS.pose + here.pose.shape[1]].T.copy()
    return replace(here, score=rows[ROWS.score], alive=rows[ROWS.alive] > 0, pose=pose)


def advance(task, before, after, control, trials, trial_data, parameters):
    """Move the pose and add the reward of the state in which the control was given."""
    nx, nu, n_pose = int(parameters[OBSERVED.nx]), int(parameters[OBSERVED.nu]), int(parameters[OBSERVED.n_pose])
    own = view(parameters, int(parameters[OBSERVED.of_nu]))
    pose = view(task, ROWS.pose * LANES)
    x = view(pose, n_pose * LANES)
    u = view(x, nx)
    move(pose, before, after, parameters[OBSERVED.dt], view(parameters, int(parameters[OBSERVED.of_motion])))
    lowest, share = own[OWN.lowest], own[OWN.share]
    for lane in range(LANES):
        for i in range(nx):
            x[i] = before[i * LANES + lane]
        for j in range(nu):
            u[j] = control[j * LANES + lane]
        reward = worth(x, u)
        task[lane] += share * (reward if reward >= lowest else lowest)
        for i in range(nx):
            x[i] = after[i * LANES + lane]
        if over(x, u):
            task[ROWS.alive * LANES + lane] = 0.0


def never(x, u):
    """No trial is over before its time."""
    return 0.0
