"""Kernels of dynamics without a controller: simulation of recorded windows, final error, one step."""

from __future__ import annotations

from typing import Any

import numpy as np

from sysid_evo.engine.compiled import loops
from sysid_evo.engine.compiled.closed_loop import Work, run_in_threads
from sysid_evo.engine.compiled.compiler import compiled, compiled_loop
from sysid_evo.engine.compiled.workspace import aligned, empty_lines
from sysid_evo.kernels import DYNAMICS, LANES, DynamicsKernel, Precision, Source
from sysid_evo.types import Array, check_shape


def free_runs(
    source: Source,
    n_scratch: int,
    parameters: Array,
    start: Array,
    controls: Array,
    state_bounds: Array,
    *,
    precision: Precision = "float64",
) -> Array:
    """Return the simulated states (P, W, H, nx) of W windows for P parameter vectors (P, m) of the kernel ``source``.

    Each vector starts from its own carries, ``start`` (P, W, n_carry); ``controls`` are (W, H, nu). States are clipped
    to ``state_bounds`` (2, nx); nan stays nan or becomes a bound.
    """
    windows, steps, nu = controls.shape
    start = check_shape("start", start, (len(parameters), windows, None))
    nx, real = state_bounds.shape[1], np.dtype(precision)
    sizes = loops.OPEN.integers(
        windows=windows, steps=steps, n_carry=start.shape[2], nx=nx, nu=nu, n_parameters=parameters.shape[1]
    )
    states = np.zeros(len(parameters) * windows * steps * nx, real)
    given = {"parameters_of": parameters, "start": start, "controls": controls, "state_bounds": state_bounds}
    compiled_loop(loops.free_runs, loops.FREE_RUNS, precision)(
        *loops.FREE_RUNS.ordered(
            dynamics=compiled(source, DYNAMICS, precision),
            sizes=sizes,
            shared=loops.FREE_SHARED.chosen({name: aligned(array, real) for name, array in given.items()}),
            work=_work(start.shape[2], nu, n_scratch, parameters.shape[1], real),
            first=0,
            last=len(parameters),
            states=states,
        )
    )
    return states.astype(np.float64, copy=False).reshape(len(parameters), windows, steps, nx)


def final_errors(
    source: Source,
    n_scratch: int,
    parameters: Array,
    start: Array,
    controls: Array,
    truth: Array,
    weight: Array | None = None,
    *,
    precision: Precision = "float32",
    threads: int = 1,
) -> Array:
    """Return the mean squared error (P,) after the last step of W windows; not finite if a simulation diverges.

    - ``source``: a dynamics kernel that needs ``n_scratch`` rows; ``parameters`` (P, m): its parameters by candidate.
    - ``start`` (W, n_carry), ``controls`` (W, H, nu), ``truth`` (W, nx): the measured states after the last step.
    - ``weight`` (nx,): factor of the squared error of each state, 1 by default.
    """
    windows, steps, nu = controls.shape
    start = check_shape("start", start, (windows, None))
    truth = check_shape("truth", truth, (windows, None))
    real = np.dtype(precision)
    weight = np.ones(truth.shape[1]) if weight is None else check_shape("weight", weight, truth.shape[1:])

    sizes = loops.OPEN.integers(
        windows=windows, steps=steps, n_carry=start.shape[1], nx=truth.shape[1], nu=nu, n_parameters=parameters.shape[1]
    )
    error = np.zeros(len(parameters), real)
    given = {"parameters_of": parameters, "start": start, "controls": controls, "truth": truth, "weight": weight}
    shared = loops.OPEN_SHARED.chosen({name: aligned(array, real) for name, array in given.items()})
    kernel, loop = compiled(source, DYNAMICS, precision), compiled_loop(loops.open_loop, loops.OPEN_LOOP, precision)

    def prepare() -> Work:
        work = _work(start.shape[1], nu, n_scratch, parameters.shape[1], real)
        arguments = {"dynamics": kernel, "sizes": sizes, "shared": shared, "work": work, "error": error}
        return lambda first, last: loop(*loops.OPEN_LOOP.ordered(first=first, last=last, **arguments))

    run_in_threads(prepare, len(parameters), threads)
    return error.astype(np.float64)


def _work(n_carry: int, nu: int, n_scratch: int, n_parameters: int, real: Any) -> tuple[Any, ...]:
    """Return the arrays for one block of windows and the parameters of one candidate."""
    rows = {"carry": n_carry, "control": nu, "noise": 1, "scratch": n_scratch}
    arrays = {name: empty_lines(n * LANES, real) for name, n in rows.items()}
    return loops.WINDOW.chosen({**arrays, "parameters": empty_lines(n_parameters, real)})


def kernel_step(
    kernel: DynamicsKernel, carry: Array, control: Array, noise: Array | None = None, *, precision: Precision
) -> Array:
    """Return the next carry (B, n_carry) under ``control`` (B, nu), with ``noise`` (B, n_noise), compiled."""
    function = compiled(kernel.source, DYNAMICS, precision)
    loop = compiled_loop(loops.one_step, loops.ONE_STEP, precision)
    noise = np.zeros((len(carry), 1)) if noise is None else noise
    parameters = aligned(kernel.parameters, precision)
    after = np.empty_like(carry)
    for first in range(0, len(carry), LANES):
        rows = np.minimum(np.arange(first, first + LANES), len(carry) - 1)
        blocks = [aligned(array[rows].T, precision) for array in (carry, control, noise)]
        loop(function, *blocks, parameters, empty_lines(kernel.n_scratch * LANES, precision))
        after[rows] = blocks[0].reshape(-1, LANES).T
    return after
