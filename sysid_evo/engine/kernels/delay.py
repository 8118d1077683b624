"""Any kernel whose state is observed late, see `sysid_evo.wrappers.DelayedEstimate`."""

from __future__ import annotations

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.engine.compiled.dialect import KernelSource
from sysid_evo.engine.compiled.kernel import DynamicsKernel
from sysid_evo.engine.compiled.lanes import LANES, view
from sysid_evo.engine.kernels.stepping import HEADER, copy

NX, AT, WHOLE, SHARE, OWN, LIMITS = range(6)


def delayed_kernel(
    inner: DynamicsKernel, nx: int, n_inner: int, *, whole: int, share: float, envelope: Array | None
) -> DynamicsKernel:
    """Return the kernel of ``inner`` (n_inner rows of carry), then what is observed, then the last ``whole`` states."""
    if envelope is None:
        envelope = np.stack([np.full(nx, -np.inf), np.full(nx, np.inf)])
    header = np.concatenate([[nx, n_inner, whole, share, 0.0], np.ravel(envelope)])  # OWN is known below
    header = np.pad(header, (0, -len(header) % HEADER))
    header[OWN] = len(header)
    return DynamicsKernel(
        KernelSource(delayed, {"inner": inner.source}),
        np.concatenate([header, np.ravel(inner.parameters)]),
        2 * nx + inner.n_scratch,
        inner.precision,
    )


def delayed(carry, control, noise, parameters, scratch):
    """Step the inner dynamics, then write what is observed and move the past states one place back."""
    nx, whole, share = int(parameters[NX]), int(parameters[WHOLE]), parameters[SHARE]
    rows = nx * LANES
    before, after = view(scratch, 0), view(scratch, rows)
    copy(carry, before, rows)
    inner(carry, control, noise, view(parameters, int(parameters[OWN])), view(scratch, 2 * rows))
    observed = view(carry, int(parameters[AT]) * LANES)
    past = view(observed, rows)
    for row in range(nx):
        here, there = view(carry, row * LANES), view(after, row * LANES)
        low, high = parameters[LIMITS + row], parameters[LIMITS + nx + row]
        for lane in range(LANES):
            there[lane] = min(max(here[lane], low), high)
    if whole == 0:
        between(after, before, share, observed, rows)
        return
    if whole == 1:
        between(before, past, share, observed, rows)
    else:
        between(view(past, (whole - 2) * rows), view(past, (whole - 1) * rows), share, observed, rows)
    for back in range(whole - 1, 0, -1):
        copy(view(past, (back - 1) * rows), view(past, back * rows), rows)
    copy(before, past, rows)


def between(later, earlier, share, observed, count):
    """Write (1 - share) later + share earlier."""
    for i in range(count):
        observed[i] = later[i] - share * (later[i] - earlier[i])
