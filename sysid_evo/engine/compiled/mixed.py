"""The mixed form: compiled controller and task around the NumPy step of any dynamics."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from sysid_evo.arrays import Array, Seeds
from sysid_evo.controllers.controller import Controller
from sysid_evo.dynamics import Dynamics, clip_state, doubted
from sysid_evo.engine import behaviour
from sysid_evo.engine.compiled import loops
from sysid_evo.engine.compiled.dialect import KernelSource, Precision, compile_kernel
from sysid_evo.engine.compiled.kernel import ADVANCE, CONTROLLER, OBSERVE, ControllerKernel, TaskKernel
from sysid_evo.engine.compiled.lanes import LANES
from sysid_evo.engine.compiled.memory import aligned, empty_lines
from sysid_evo.engine.compiled.run import compiled
from sysid_evo.engine.compiled.tables import actuation_table
from sysid_evo.randomness import step_noise, trial_draws
from sysid_evo.tasks.task import Task

ENGINE = "mixed float32"
PRECISION: Precision = "float32"
REAL = np.dtype(PRECISION)


@cache
def _loops() -> tuple[Any, Any]:
    return (
        compile_kernel(KernelSource(loops.decide), loops.DECIDE, PRECISION, pointer=False),
        compile_kernel(KernelSource(loops.settle), loops.SETTLE, PRECISION, pointer=False),
    )


def run(
    controller_kernel: ControllerKernel,
    task_kernel: TaskKernel,
    dynamics: Dynamics,
    controller: Controller,
    parameters: Array,
    task: Task,
    seeds: Seeds,
) -> dict[str, Any]:
    """Run bound ``controller`` and ``task`` compiled and ``dynamics`` as it is; return the fields of `Rollouts`."""
    system, candidates, trials = dynamics.system, len(parameters), len(seeds)
    rollouts, nx, nu = candidates * trials, dynamics.system.nx, dynamics.system.nu
    blocks = -(-rollouts // LANES)
    began = task.begin(seeds)
    tiled = began.tile(candidates)
    rows = task_kernel.rows(began)
    noise = step_noise(seeds, task.horizon, dynamics.n_noise)
    states = np.repeat(tiled.state[:, None], dynamics.n_lags + 1, axis=1)
    past = np.tile(system.neutral_control, (rollouts, dynamics.n_lags, 1))
    carry = dynamics.start(states, past, np.tile(trial_draws(seeds, dynamics.n_draws), (candidates, 1)))

    lane_of = np.minimum(np.arange(blocks * LANES), rollouts - 1)
    task_rows = _blocks(rows[:, lane_of % trials])
    theta = _blocks(parameters[lane_of // trials].T)
    memory = empty_lines(blocks * controller.n_memory * LANES, REAL)
    sizes = loops.MIXED.integers(
        trials=trials,
        nx=nx,
        nu=nu,
        n_memory=controller.n_memory,
        n_task=len(rows),
        n_theta=parameters.shape[1],
        rollouts=rollouts,
    )
    buffer = {
        name: empty_lines(n * LANES, REAL)
        for name, n in {
            "carry": nx, "before": nx, "control": nu, "observation": len(task.observations), "raw": nu,
            "scratch": controller_kernel.n_scratch, "kept": len(rows),
        }.items()
    }  # fmt: skip
    act = compiled(controller_kernel.source, CONTROLLER, PRECISION)
    observe = compiled(task_kernel.observe, OBSERVE, PRECISION)
    advance = compiled(task_kernel.advance, ADVANCE, PRECISION)
    act_parameters, task_parameters, actuation, trial_data = (
        aligned(array, REAL)
        for array in (
            controller_kernel.parameters,
            task_kernel.parameters,
            actuation_table(system, PRECISION, before_tanh=controller_kernel.before_tanh),
            task_kernel.trial_data(began),
        )
    )
    decide, settle = _loops()

    control = np.zeros(rollouts * nu, REAL)
    survived, clipped, dead = (np.zeros(rollouts, np.int64) for _ in range(3))
    diverged = np.zeros(rollouts, dtype=bool)
    counts, centre = np.zeros((rollouts, 2 * (nx + nu))), behaviour.neutral(system)
    trial_of_lane = np.zeros(LANES, np.int64)
    alive_rows = task_rows.reshape(blocks, len(rows), LANES)[:, 1]
    with np.errstate(all="ignore"):
        for k in range(task.horizon):
            alive = (alive_rows.reshape(-1)[:rollouts] != 0) & ~diverged
            if not alive.any():
                break
            state = np.ascontiguousarray(carry[:, :nx], dtype=REAL)
            seen = np.ascontiguousarray(carry[:, dynamics.observed_at :][:, :nx], dtype=REAL)
            decide(
                *loops.DECIDE.ordered(
                    controller=act,
                    observe=observe,
                    sizes=sizes,
                    controller_parameters=act_parameters,
                    task_parameters=task_parameters,
                    actuation=actuation,
                    state=seen.reshape(-1),
                    theta_of=theta,
                    memory_of=memory,
                    task_of=task_rows,
                    control_of=control,
                    **{name: buffer[name] for name in ("carry", "control", "observation", "raw", "scratch")},
                )
            )
            legal = control.reshape(rollouts, nu).astype(np.float64)
            if k % behaviour.EVERY == 0:
                counts += behaviour.sides(state, legal, centre) & alive[:, None]
            draw = np.tile(noise[:, k], (candidates, 1)) if dynamics.n_noise else None
            stepped = dynamics.step(carry, legal, draw)
            diverged |= alive & ~np.isfinite(stepped).all(axis=1)
            going = alive & ~diverged
            stepped, touched = clip_state(stepped, dynamics.envelope)
            reached = np.ascontiguousarray(stepped[:, :nx], dtype=REAL)
            dead[:] = ~going
            settle(
                *loops.SETTLE.ordered(
                    advance=advance,
                    sizes=sizes,
                    task_parameters=task_parameters,
                    trial_data=trial_data,
                    state=state.reshape(-1),
                    reached=reached.reshape(-1),
                    control_of=control,
                    task_of=task_rows,
                    dead_of=dead,
                    trials=trial_of_lane,
                    **{name: buffer[name] for name in ("before", "carry", "control", "kept")},
                )
            )
            altered = reached != stepped[:, :nx].astype(REAL)
            if altered.any():
                stepped = stepped.copy()
                stepped[:, :nx][altered] = reached[altered]
            carry = stepped if going.all() else np.where(going[:, None], stepped, carry)
            survived += going
            clipped += touched & going
    final = task_rows.reshape(blocks, len(rows), LANES).transpose(1, 0, 2).reshape(len(rows), -1)[:, :rollouts]
    fitness = np.where(diverged, task.worst - 1.0 + survived / task.horizon, final[0].astype(np.float64))
    grid = (candidates, trials)
    return {
        "fitness": fitness.reshape(grid),
        "survived": survived.reshape(grid),
        "clipped": clipped.reshape(grid),
        "behaviour": behaviour.shares(counts, survived, diverged).reshape(*grid, -1),
        "doubt": doubted(dynamics, carry, diverged).reshape(grid),
        "task_state": task_kernel.state(tiled, final),
        "engine": ENGINE,
    }


def _blocks(rows: Array) -> Any:
    """Turn (n, blocks * LANES) into blocks of n rows of 64 lanes, flat and aligned."""
    return aligned(rows.reshape(len(rows), -1, LANES).transpose(1, 0, 2), REAL)
