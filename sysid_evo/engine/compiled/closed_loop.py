"""The compiled closed loop: its arrays, threads and results.

This module works with kernels and numbers only. `sysid_evo.engine.rollout` begins the trials and converts the results
to `Rollouts`.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from typing import Any, TypeAlias

import numpy as np

from sysid_evo.engine.compiled import loops
from sysid_evo.engine.compiled.compiler import compiled, compiled_loop
from sysid_evo.engine.compiled.workspace import actuation_table, aligned, bounds_table, noise_table, together
from sysid_evo.kernels import (
    ADVANCE,
    CONTROLLER,
    DYNAMICS,
    LANES,
    OBSERVE,
    ControllerKernel,
    DynamicsKernel,
    Precision,
    TaskKernel,
)
from sysid_evo.system import System
from sysid_evo.types import Array, BoolArray, IntArray

PARTS_PER_THREAD = 2  # parts of the work for each thread


@dataclass(frozen=True)
class LoopTrials:
    """Start of P candidates, ``theta`` (P, n), in E trials: ``carry`` (E, n_carry) and ``noise`` (E, horizon, n_noise).

    ``task`` (rows, E) and ``trial_data`` (E, n) come from the `TaskKernel`.
    """

    theta: Array
    carry: Array
    task: Array
    trial_data: Array
    noise: Array


@dataclass(frozen=True)
class LoopResults:
    """Results of B = P E rollouts, candidate first, trial second; a rollout that ``diverged`` ended at that step.

    ``counts`` (B, d) are the counts of the behaviour samples, ``outside`` (B,) the steps outside the data. ``tape``
    holds the recorded states (B, horizon + 1, nx), controls (B, horizon, nu) and poses (B, horizon + 1, n_pose), flat
    or not.
    """

    fitness: Array
    survived: IntArray
    clipped: IntArray
    diverged: BoolArray
    counts: Array
    outside: Array
    tape: tuple[Array, Array, Array]


class LoopData:
    """A compiled closed loop and the data that all trials share, in one precision.

    ``n_memory`` and ``n_observations`` are sizes of the controller. ``observed_at`` is the first row of the observed
    state in the carry, ``outside_at`` the row that counts the steps outside the data, None without a count. States are
    clipped to ``state_bounds`` (2, nx).
    """

    def __init__(
        self,
        dynamics: DynamicsKernel,
        controller: ControllerKernel,
        task: TaskKernel[Any],
        system: System,
        *,
        n_memory: int,
        n_observations: int,
        observed_at: int = 0,
        outside_at: int | None = None,
        state_bounds: Array | None = None,
        precision: Precision = "float32",
    ) -> None:
        self.task, self.precision = task, precision
        self.loop = compiled_loop(loops.closed_loop, loops.CLOSED_LOOP, precision)
        self.functions = {
            "dynamics": compiled(dynamics.source, DYNAMICS, precision),
            "controller": compiled(controller.source, CONTROLLER, precision),
            "observe": compiled(task.observe, OBSERVE, precision),
            "advance": compiled(task.advance, ADVANCE, precision),
        }
        tables = {
            "dynamics_parameters": dynamics.parameters,
            "controller_parameters": controller.parameters,
            "task_parameters": task.parameters,
            "state_bounds": bounds_table(state_bounds, system.nx, precision),
            "actuation": actuation_table(system, precision, before_tanh=controller.before_tanh),
            "centre": np.concatenate([system.neutral_state, system.neutral_control]),
        }
        self.tables = {name: aligned(array, precision) for name, array in tables.items()}
        self.sizes = {
            "nx": system.nx,
            "nu": system.nu,
            "n_memory": n_memory,
            "pose_row": task.pose_row,
            "n_pose": task.n_pose,
            "observed_at": observed_at,
            "outside_at": -1 if outside_at is None else outside_at,
        }
        self.rows = {
            "control": system.nu,
            "memory": n_memory,
            "observation": max(1, n_observations),
            "raw": system.nu,
            "before": system.nx,
            "sign_counts": 2 * (system.nx + system.nu),
            "trial_index": 1,
            "scratch": dynamics.n_scratch,
            "controller_scratch": controller.n_scratch,
        }

    def run(self, loop_trials: LoopTrials, *, record: bool, threads: int = 1) -> tuple[LoopResults, Array]:
        """Return the results, which do not depend on ``threads``, and the final rows of the task, (rows, P E)."""
        real, (trials, horizon, n_noise) = np.dtype(self.precision), loop_trials.noise.shape
        candidates, n_theta = loop_trials.theta.shape
        n_carry, n_task = loop_trials.carry.shape[1], len(loop_trials.task)
        nx, nu, n_pose, rollouts = self.sizes["nx"], self.sizes["nu"], self.sizes["n_pose"], candidates * trials
        sizes = loops.CLOSED.integers(
            **self.sizes,
            trials=trials,
            horizon=horizon,
            n_carry=n_carry,
            n_task=n_task,
            n_noise=n_noise,
            n_theta=n_theta,
            rollouts=rollouts,
            record=int(record),
        )
        shared = {
            "noise_of": noise_table(loop_trials.noise, self.precision),
            **self.tables,
            "theta_of": aligned(loop_trials.theta, real),
            "start": aligned(loop_trials.carry, real),
            "task_start": aligned(loop_trials.task.T, real),
            "trial_data": aligned(loop_trials.trial_data, real),
        }
        recorded = rollouts if record else 0
        lengths = {
            "fitness": rollouts,
            "final_task": rollouts * n_task,
            "counts": rollouts * 2 * (nx + nu),
            "outside": rollouts,
            "states": max(1, recorded * (horizon + 1) * nx),
            "controls": max(1, recorded * horizon * nu),
            "poses": max(1, recorded * (horizon + 1) * n_pose),
        }
        results = {name: np.zeros(length, real) for name, length in lengths.items()}
        outcomes = {name: np.zeros(rollouts, np.int64) for name in loops.OUTCOMES.names}
        own = {"carry": n_carry, "noise": n_noise, "task": n_task, "theta": n_theta, "snapshot": n_carry + n_task}
        rows = {**self.rows, **own}

        def prepare() -> Work:
            tables = dict(zip(loops.SHARED.names, loops.SHARED.chosen(shared), strict=True))
            arrays = together({name: rows[name] * LANES for name in loops.WORK.names}, real, copies=tables)
            arguments = {
                **self.functions,
                "sizes": sizes,
                "shared": loops.SHARED.chosen(arrays),
                "work": loops.WORK.chosen(arrays),
                "trials": np.zeros(LANES, np.int64),
                "results": loops.RESULTS.chosen(results),
                "outcomes": loops.OUTCOMES.chosen(outcomes),
            }
            return lambda first, last: self.loop(*loops.CLOSED_LOOP.ordered(first=first, last=last, **arguments))

        run_in_threads(prepare, -(-rollouts // LANES), threads)
        found = LoopResults(
            fitness=results["fitness"].astype(np.float64),
            survived=outcomes["survived"],
            clipped=outcomes["clipped"],
            diverged=outcomes["diverged"] > 0,
            counts=results["counts"].reshape(rollouts, -1).astype(np.float64),
            outside=results["outside"].astype(np.float64),
            tape=(results["states"], results["controls"], results["poses"]),
        )
        return found, results["final_task"].reshape(rollouts, n_task).T.astype(np.float64)


@cache
def thread_pool(threads: int) -> ThreadPoolExecutor:
    """Return a pool of ``threads`` threads, which lives as long as the process."""
    return ThreadPoolExecutor(threads, thread_name_prefix="rollout")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=thread_pool.cache_clear)  # threads do not survive a fork


Work: TypeAlias = Callable[[int, int], None]


def run_in_threads(prepare: Callable[[], Work], count: int, threads: int) -> None:
    """Call ``work(first, last)`` for all of ``range(count)`` on up to ``threads`` threads, including this one.

    Each thread prepares its own work (buffers), then takes parts until none are left, so that no thread waits for one
    with slower rollouts or a busier processor.
    """
    threads = max(1, min(threads, count))
    if threads == 1:
        prepare()(0, count)
        return
    size = max(1, count // (PARTS_PER_THREAD * threads))
    begins = iter(range(0, count, size))

    def take() -> None:
        work = prepare()
        for first in begins:
            work(first, min(first + size, count))

    others = [thread_pool(threads - 1).submit(take) for _ in range(threads - 1)]
    take()
    for other in others:
        other.result()
