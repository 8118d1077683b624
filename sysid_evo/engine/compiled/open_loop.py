"""Open loop over windows: the multi-step error of a whole population of parameter vectors."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from sysid_evo.arrays import Array, check_shape
from sysid_evo.engine.compiled import loops
from sysid_evo.engine.compiled.dialect import KernelSource, Precision, Source, compile_kernel
from sysid_evo.engine.compiled.kernel import DYNAMICS
from sysid_evo.engine.compiled.lanes import LANES
from sysid_evo.engine.compiled.run import Work, aligned, compiled, spread


@cache
def _loop(precision: Precision) -> Any:
    return compile_kernel(KernelSource(loops.open_loop), loops.OPEN_LOOP, precision, pointer=False)


def final_errors(
    source: Source,
    n_scratch: int,
    parameters: Array,
    start: Array,
    controls: Array,
    truth: Array,
    *,
    precision: Precision = "float32",
    threads: int = 1,
) -> Array:
    """Return the mean square error (P,) after the last step of W windows; not finite where it diverges.

    ``source`` is a dynamics kernel that needs ``n_scratch`` rows; ``parameters`` (P, m) are its flat
    parameters for every candidate; ``start`` (W, n_carry), ``controls`` (W, H, nu), ``truth``
    (W, nx) at the end.
    """
    windows, steps, nu = controls.shape
    start = check_shape("start", start, (windows, None))
    truth = check_shape("truth", truth, (windows, None))
    real = np.dtype(precision)

    def flat(array: Array) -> Any:
        with np.errstate(over="ignore"):  # a number beyond float32 is infinite
            return aligned(np.ascontiguousarray(array, dtype=real).reshape(-1))

    sizes = np.zeros(16, np.int64)
    sizes[: loops.OPEN_PARAMETERS + 1] = (
        len(parameters), windows, steps, start.shape[1], truth.shape[1], nu, parameters.shape[1],
    )  # fmt: skip
    error = np.zeros(len(parameters), real)
    shared = (sizes, flat(parameters), flat(start), flat(controls), flat(truth))
    kernel, loop = compiled(source, DYNAMICS, precision), _loop(precision)

    def prepare() -> Work:
        rows = (start.shape[1], nu, 1)
        buffers = [aligned(np.zeros(n * LANES, real)) for n in rows]
        own, scratch = aligned(np.zeros(parameters.shape[1], real)), aligned(np.zeros(n_scratch * LANES, real))

        def work(first: int, last: int) -> None:
            loop(kernel, *shared, first, last, *buffers, own, scratch, error)

        return work

    spread(prepare, len(parameters), threads)
    return error.astype(np.float64)
