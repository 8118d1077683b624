"""Any kernel whose state is observed late, see `sysid_evo.wrappers.DelayedEstimate`."""

from __future__ import annotations

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.engine.kernels.stepping import copy
from sysid_evo.kernels import CACHE_LINE, LANES, DynamicsKernel, KernelSource, Layout, padded, view

HEAD = Layout("nx", "at", "whole", "share", "own", align=CACHE_LINE)


def delayed_kernel(
    inner: DynamicsKernel, nx: int, n_inner: int, *, whole: int, share: float, envelope: Array | None
) -> DynamicsKernel:
    """Return the kernel of ``inner`` (n_inner rows of carry), then what is observed, then the last ``whole`` states."""
    if envelope is None:
        envelope = np.stack([np.full(nx, -np.inf), np.full(nx, np.inf)])
    limits = padded(np.ravel(envelope))
    parameters = HEAD.pack(
        limits, inner.parameters, nx=nx, at=n_inner, whole=whole, share=share, own=HEAD.size + len(limits)
    )
    return DynamicsKernel(
        KernelSource(delayed, {"inner": inner.source}), parameters, 2 * nx + inner.n_scratch, inner.precision
    )


def delayed(carry, control, noise, parameters, scratch):
    """Step the inner dynamics, then write what is observed and move the past states one place back."""
    nx, whole, share = int(parameters[HEAD.nx]), int(parameters[HEAD.whole]), parameters[HEAD.share]
    rows = nx * LANES
    before, after = view(scratch, 0), view(scratch, rows)
    copy(carry, before, rows)
    inner(carry, control, noise, view(parameters, int(parameters[HEAD.own])), view(scratch, 2 * rows))
    observed = view(carry, int(parameters[HEAD.at]) * LANES)
    past = view(observed, rows)
    for row in range(nx):
        here, there = view(carry, row * LANES), view(after, row * LANES)
        low, high = parameters[HEAD.size + row], parameters[HEAD.size + nx + row]
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
