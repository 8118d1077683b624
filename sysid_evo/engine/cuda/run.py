"""Rollouts on a device: runs the program in batches that fit its memory, and reads the results."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import cuda
from numba.cuda.core.errors import NumbaPerformanceWarning

from sysid_evo.arrays import Array, Seeds
from sysid_evo.controllers.controller import Controller
from sysid_evo.dynamics import Dynamics
from sysid_evo.engine import behaviour
from sysid_evo.engine.compiled.dialect import Precision
from sysid_evo.engine.compiled.run import Kernels, trajectories
from sysid_evo.engine.cuda import lanes, program
from sysid_evo.engine.cuda.trials import WHOLE, Given, prepare
from sysid_evo.tasks.task import Task

WIDTHS = (4, 2, 1) if lanes.SIMULATED else (128, 64, 32)
"""Threads of a block; the widest is taken whose candidates fit into shared memory, and that leaves none idle."""
MULTIPROCESSORS = 132
"""Of a large device: with fewer blocks some of them have nothing to do."""
SHARED_BYTES = 48 * 1024
"""What a block may have without asking for more."""
PART = 0.5
"""The part of the free memory of the device that the results of one batch may take."""


@dataclass(frozen=True)
class Launch:
    """How a batch is run: its program, the threads of a block and their shared memory."""

    threads: program.Threads
    width: int
    shared_bytes: int


def launch_of(kernels: Kernels, given: Given, rollouts: int, precision: Precision) -> Launch:
    """Return the program of ``kernels``, with as much in shared memory as fits: candidates first, small arrays next."""
    widths = [width for width in WIDTHS if rollouts >= width * MULTIPROCESSORS] or list(WIDTHS[-1:])
    itemsize, stride = np.dtype(precision).itemsize, program.odd(given.sizes["N_THETA"])
    left, shared, width = SHARED_BYTES, set(), widths[0]
    for threads in widths:
        of_theta = ((threads - 1) // given.trials + 2) * stride * itemsize
        if of_theta <= SHARED_BYTES // 2:
            shared, width, left = {"theta"}, threads, SHARED_BYTES - of_theta
            break
    for name in sorted(program.GIVEN, key=lambda name: len(given.arrays[name])):
        size = len(given.arrays[name]) * itemsize
        if size <= left // 2:
            shared.add(name)
            left -= size
    threads_of = program.Threads({**kernels.sources, **given.sizes}, given.room, frozenset(shared))
    return Launch(threads_of, width, SHARED_BYTES - left)


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
) -> dict[str, Any]:
    """Run bound ``controller`` and ``task`` on the device; return the fields of `Rollouts`."""
    given, real = prepare(kernels, dynamics, controller, task, seeds, precision, record=record), np.dtype(precision)
    launch = launch_of(kernels, given, len(parameters) * given.trials, precision)
    entry = program.compiled(launch.threads, precision)
    shared = {name: on_device(array, real) for name, array in given.arrays.items()}
    found = []
    for batch in batches(len(parameters), given, real):
        rollouts = (batch.stop - batch.start) * given.trials
        results = {
            name: cuda.device_array(max(1, count * rollouts), np.int64 if name in WHOLE else real)
            for name, count in given.results.items()
        }
        arguments = {
            "rollouts": rollouts,
            "trials_in_all": given.trials,
            "horizon": task.horizon,
            "theta_of": on_device(parameters[batch], real),
            **{f"n_{name}": len(given.arrays[name]) for name in program.GIVEN},
            **shared,
            **results,
        }
        ordered = [arguments[name] for name in program.ARGUMENTS]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NumbaPerformanceWarning)  # few rollouts leave much of a device idle
            entry[-(-rollouts // launch.width), launch.width, 0, launch.shared_bytes](*ordered)
        found.append({name: array.copy_to_host() for name, array in results.items() if given.results[name]})
    return _read(found, kernels, dynamics, task, given, f"cuda {precision}")


def on_device(array: Array, real: Any) -> Any:
    """Return a flat copy of ``array`` on the device, at least one number."""
    with np.errstate(over="ignore"):  # a number beyond float32 is infinite
        flat = np.ascontiguousarray(array, dtype=real).ravel()
    return cuda.to_device(flat if flat.size else np.zeros(1, real))


def batches(candidates: int, given: Given, real: Any) -> list[slice]:
    """Return which candidates are run at once, so that what they give fits into the memory of the device."""
    sizes = {name: count * (8 if name in WHOLE else real.itemsize) for name, count in given.results.items()}
    fitting = PART * free_memory() / (given.trials * sum(sizes.values()))
    most = int(min(candidates, max(1.0, fitting)))
    return [slice(first, min(first + most, candidates)) for first in range(0, candidates, most)]


def free_memory() -> float:
    """Return how many bytes of the device are free."""
    return float(cuda.current_context().get_memory_info().free)


def _read(
    found: list[dict[str, Any]], kernels: Kernels, dynamics: Dynamics, task: Task, given: Given, engine: str
) -> dict[str, Any]:
    """Return the fields of `Rollouts` from the arrays of all batches."""
    system, trials = dynamics.system, given.trials
    survived, clipped, diverged, fitness, doubts = (
        np.concatenate([part[name] for part in found])
        for name in ("survived", "clipped", "diverged", "fitness", "doubts")
    )
    final, counts = (
        np.concatenate([part[name].reshape(-1, len(part["fitness"])) for part in found], axis=1).astype(np.float64)
        for name in ("final_task", "counts")
    )
    lost, candidates = diverged > 0, len(fitness) // trials
    grid = (candidates, trials)
    score = np.where(lost, task.worst - 1.0 + survived / task.horizon, fitness.astype(np.float64))
    doubt = np.zeros(len(lost)) if dynamics.doubt_at is None else np.where(lost, 0.0, doubts.astype(np.float64))
    tape = [np.concatenate([part.get(name, np.empty(0)) for part in found]) for name in ("states", "controls", "poses")]
    return {
        "fitness": score.reshape(grid),
        "survived": survived.reshape(grid),
        "clipped": clipped.reshape(grid),
        "behaviour": behaviour.shares(counts.T, survived, lost).reshape(*grid, -1),
        "doubt": doubt.reshape(grid),
        "task_state": kernels.task.state(given.began.tile(candidates), final),
        "engine": engine,
        "trajectories": trajectories(tape, survived, given.began.pose, task, system, trials) if len(tape[0]) else (),
    }
