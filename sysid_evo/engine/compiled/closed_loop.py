"""The fast form of the rollout: prepares arrays, runs the compiled loop on threads, reads the results."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from typing import Any, TypeAlias

import numpy as np

from sysid_evo.controllers.controller import Controller
from sysid_evo.engine import results as results_module
from sysid_evo.engine.compiled import loops
from sysid_evo.engine.compiled.compiler import compile_kernel, compiled
from sysid_evo.engine.compiled.workspace import actuation_table, aligned, envelope_table, noise_table, together
from sysid_evo.engine.results import trajectories
from sysid_evo.kernels import (
    ADVANCE,
    CONTROLLER,
    DYNAMICS,
    LANES,
    OBSERVE,
    ControllerKernel,
    DynamicsKernel,
    KernelSource,
    Precision,
    TaskKernel,
)
from sysid_evo.models.dynamics import Dynamics
from sysid_evo.randomness import step_noise, trial_draws
from sysid_evo.tasks.task import Task
from sysid_evo.types import Array, Seeds

SHARES = 2  # parts of the work for each thread


@dataclass(frozen=True)
class Kernels:
    """The three kernels of a rollout."""

    dynamics: DynamicsKernel
    controller: ControllerKernel
    task: TaskKernel[Any]


@cache
def closed_loop(precision: Precision) -> Any:
    """Return the compiled loop."""
    return compile_kernel(KernelSource(loops.closed_loop), loops.CLOSED_LOOP, precision, pointer=False)


@cache
def pool(threads: int) -> ThreadPoolExecutor:
    """Return a pool of that many threads, kept for the life of the process."""
    return ThreadPoolExecutor(threads, thread_name_prefix="rollout")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=pool.cache_clear)  # a forked process has none of its parent's threads


Work: TypeAlias = Callable[[int, int], None]


def spread(prepare: Callable[[], Work], count: int, threads: int) -> None:
    """Do ``work(first, last)`` for all of ``range(count)``, on up to ``threads`` threads, this one among them.

    Every thread prepares its own work (buffers) and then takes the next few until none are left, so
    that no thread waits for one with slower rollouts or a busier processor.
    """
    threads = max(1, min(threads, count))
    if threads == 1:
        prepare()(0, count)
        return
    size = max(1, count // (SHARES * threads))
    begins = iter(range(0, count, size))

    def take() -> None:
        work = prepare()
        for first in begins:
            work(first, min(first + size, count))

    others = [pool(threads - 1).submit(take) for _ in range(threads - 1)]
    take()
    for other in others:
        other.result()


def run(
    kernels: Kernels,
    dynamics: Dynamics,
    controller: Controller,
    parameters: Array,
    task: Task,
    seeds: Seeds,
    *,
    record: bool,
    precision: Precision = "float32",
    threads: int = 1,
) -> dict[str, Any]:
    """Run bound ``controller`` and ``task`` compiled; return the fields of `Rollouts`."""
    system, real = dynamics.system, np.dtype(precision)
    candidates, trials = len(parameters), len(seeds)
    rollouts = candidates * trials
    began = task.begin(seeds)
    states = np.repeat(began.state[:, None], dynamics.n_lags + 1, axis=1)
    past = np.tile(system.neutral_control, (trials, dynamics.n_lags, 1))
    carry = dynamics.start(states, past, trial_draws(seeds, dynamics.n_draws))
    rows = kernels.task.rows(began)
    noise = np.empty((trials, task.horizon, dynamics.n_noise))

    def draw(first: int, last: int) -> None:
        noise[first:last] = step_noise(seeds[first:last], task.horizon, dynamics.n_noise)

    if dynamics.n_noise:
        spread(lambda: draw, trials, threads)
    sizes = loops.CLOSED.integers(
        trials=trials,
        horizon=task.horizon,
        n_carry=carry.shape[1],
        nx=system.nx,
        nu=system.nu,
        n_memory=controller.n_memory,
        n_task=len(rows),
        n_noise=dynamics.n_noise,
        n_theta=parameters.shape[1],
        rollouts=rollouts,
        record=int(record),
        pose_row=kernels.task.pose_row,
        n_pose=kernels.task.n_pose,
        seen=dynamics.observed_at,
        doubt_at=-1 if dynamics.doubt_at is None else dynamics.doubt_at,
    )
    functions = {
        "dynamics": compiled(kernels.dynamics.source, DYNAMICS, precision),
        "controller": compiled(kernels.controller.source, CONTROLLER, precision),
        "observe": compiled(kernels.task.observe, OBSERVE, precision),
        "advance": compiled(kernels.task.advance, ADVANCE, precision),
    }
    given = {
        "dynamics_parameters": kernels.dynamics.parameters,
        "controller_parameters": kernels.controller.parameters,
        "task_parameters": kernels.task.parameters,
        "theta_of": parameters,
        "start": carry,
        "task_start": rows.T,
        "trial_data": kernels.task.trial_data(began),
        "envelope": envelope_table(dynamics.envelope, system.nx, precision),
        "actuation": actuation_table(system, precision, before_tanh=kernels.controller.before_tanh),
        "centre": results_module.neutral(system),
    }
    shared = {
        "noise_of": noise_table(noise, precision),
        **{name: aligned(array, real) for name, array in given.items()},
    }
    fitness, final = np.zeros(rollouts, real), np.zeros(rollouts * len(rows), real)
    survived, clipped, diverged = (np.zeros(rollouts, np.int64) for _ in range(3))
    counts, doubts = np.zeros(rollouts * 2 * (system.nx + system.nu), real), np.zeros(rollouts, real)
    kept = rollouts if record else 0
    tape = {
        "states": np.zeros(max(1, kept * (task.horizon + 1) * system.nx), real),
        "controls": np.zeros(max(1, kept * task.horizon * system.nu), real),
        "poses": np.zeros(max(1, kept * (task.horizon + 1) * kernels.task.n_pose), real),
    }
    results = {
        "fitness": fitness, "survived": survived, "clipped": clipped, "diverged": diverged, "final_task": final,
        "counts": counts, "doubts": doubts, **tape,
    }  # fmt: skip
    room = {
        "carry": carry.shape[1],
        "control": system.nu,
        "noise": dynamics.n_noise,
        "memory": controller.n_memory,
        "observation": max(1, len(task.observations)),
        "raw": system.nu,
        "before": system.nx,
        "task": len(rows),
        "theta": parameters.shape[1],
        "kept": carry.shape[1] + len(rows),
        "tally": 2 * (system.nx + system.nu),
        "turn": 1,
        "scratch": kernels.dynamics.n_scratch,
        "controller_scratch": kernels.controller.n_scratch,
    }
    loop = closed_loop(precision)

    def prepare() -> Work:
        arrays = together({name: n * LANES for name, n in room.items()}, real, copies=shared)
        trials_of = np.zeros(LANES, np.int64)

        def work(first: int, last: int) -> None:
            arguments = {**functions, "sizes": sizes, "trials": trials_of, **arrays, **results}
            loop(*loops.CLOSED_LOOP.ordered(first=first, last=last, **arguments))

        return work

    spread(prepare, -(-rollouts // LANES), threads)
    score = np.where(diverged > 0, task.worst - 1.0 + survived / task.horizon, fitness.astype(np.float64))
    final_rows = final.reshape(rollouts, len(rows)).T.astype(np.float64)
    grid = (candidates, trials)
    return {
        "fitness": score.reshape(grid),
        "survived": survived.reshape(grid),
        "clipped": clipped.reshape(grid),
        "behaviour": results_module.shares(
            counts.reshape(rollouts, -1).astype(np.float64), survived, diverged > 0
        ).reshape(*grid, -1),
        "doubt": np.where(diverged > 0, 0.0, doubts.astype(np.float64)).reshape(grid),
        "task_state": kernels.task.state(began.tile(candidates), final_rows),
        "engine": f"compiled {precision}",
        "trajectories": trajectories(list(tape.values()), survived, began.pose, task, system, trials) if record else (),
    }
