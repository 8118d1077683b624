"""Any fine kernel repeated under a held control, see `HeldControl`."""

from __future__ import annotations

import numpy as np

from sysid_evo.engine.compiled.dialect import KernelSource
from sysid_evo.engine.compiled.kernel import DynamicsKernel
from sysid_evo.engine.compiled.lanes import LANES, view

REPEATS, N_NOISE, HEADER = range(3)


def held_kernel(fine: DynamicsKernel, repeats: int, n_noise: int) -> DynamicsKernel:
    """Return the kernel that repeats ``fine``, which takes ``n_noise`` rows of noise each time."""
    return DynamicsKernel(
        KernelSource(held, {"fine": fine.source}),
        np.concatenate([[repeats, n_noise], np.ravel(fine.parameters)]),
        fine.n_scratch,
    )


def held(carry, control, noise, parameters, scratch):
    """Repeat the fine step, each time with the next rows of noise."""
    own, rows = view(parameters, HEADER), int(parameters[N_NOISE]) * LANES
    for k in range(int(parameters[REPEATS])):
        fine(carry, control, view(noise, k * rows), own, scratch)
