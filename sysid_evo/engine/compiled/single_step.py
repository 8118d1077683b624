"""One step of a dynamics kernel by itself: what the contract compares with `Dynamics.step`."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.engine.compiled import loops
from sysid_evo.engine.compiled.dialect import compile_kernel
from sysid_evo.engine.compiled.memory import aligned, empty_lines
from sysid_evo.engine.compiled.run import compiled
from sysid_evo.kernels import DYNAMICS, LANES, DynamicsKernel, KernelSource, Precision


def kernel_step(
    kernel: DynamicsKernel, carry: Array, control: Array, noise: Array | None = None, *, precision: Precision
) -> Array:
    """Return the next carry (B, n_carry) under ``control`` (B, nu), with ``noise`` (B, n_noise), compiled."""
    function, loop = compiled(kernel.source, DYNAMICS, precision), _loop(precision)
    noise = np.zeros((len(carry), 1)) if noise is None else noise
    parameters = aligned(kernel.parameters, precision)
    after = np.empty_like(carry)
    for first in range(0, len(carry), LANES):
        rows = np.minimum(np.arange(first, first + LANES), len(carry) - 1)
        blocks = [aligned(array[rows].T, precision) for array in (carry, control, noise)]
        loop(function, *blocks, parameters, empty_lines(kernel.n_scratch * LANES, precision))
        after[rows] = blocks[0].reshape(-1, LANES).T
    return after


@cache
def _loop(precision: Precision) -> Any:
    return compile_kernel(KernelSource(loops.one_step), loops.ONE_STEP, precision, pointer=False)
