"""Any kernel with noise in every step, new and lasting, whose size depends on the steps since the start."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.kernels import (
    CACHE_LINE,
    LANES,
    DynamicsKernel,
    KernelSource,
    Layout,
    load,
    padded,
    splat,
    store,
    view,
    where_less,
)
from sysid_evo.system import System

HEAD = Layout("nx", "at", "edges", "sizes", "limits", "own", align=CACHE_LINE)


def disturbed_kernel(
    inner: DynamicsKernel, system: System, n_inner: int, *, edges: Sequence[int], white: Array, lasting: Array
) -> DynamicsKernel:
    """Return the kernel of ``inner`` (n_inner rows of carry), then the lasting draws (nx) and the count of steps.

    ``white`` and ``lasting`` (len(edges) + 1, nx) are the sizes of the noise, in units of the states; one row holds
    until the count reaches its edge. The state stays within the limits of its channels.
    """
    nx = system.nx
    low, high = system.limits if system.limited else (np.full(nx, -np.inf), np.full(nx, np.inf))
    sizes = np.concatenate([white, lasting], axis=1)
    numbers = padded(np.concatenate([np.array(edges, dtype=np.float64), np.ravel(sizes), low, high]))
    first = HEAD.size + len(edges)
    parameters = HEAD.pack(
        numbers,
        inner.parameters,
        nx=nx,
        at=n_inner,
        edges=len(edges),
        sizes=first,
        limits=first + sizes.size,
        own=HEAD.size + len(numbers),
    )
    return DynamicsKernel(KernelSource(disturb, {"inner": inner.source}), parameters, inner.n_scratch, inner.precision)


def disturb(carry, control, noise, parameters, scratch):
    """Step, move the state by the noise of this step, and count it."""
    nx, edges = int(parameters[HEAD.nx]), int(parameters[HEAD.edges])
    inner(carry, control, noise, view(parameters, int(parameters[HEAD.own])), scratch)
    held = view(carry, int(parameters[HEAD.at]) * LANES)
    sizes, limits = view(parameters, int(parameters[HEAD.sizes])), view(parameters, int(parameters[HEAD.limits]))
    count = load(held, nx * LANES)
    for row in range(nx):
        white, lasting = splat(sizes[2 * nx * edges + row]), splat(sizes[2 * nx * edges + nx + row])
        for back in range(edges):
            edge = edges - 1 - back
            white = where_less(count, parameters[HEAD.size + edge], sizes[2 * nx * edge + row], white)
            lasting = where_less(count, parameters[HEAD.size + edge], sizes[2 * nx * edge + nx + row], lasting)
        moved = white * load(noise, row * LANES) + lasting * load(held, row * LANES)
        there = load(carry, row * LANES) + moved
        store(carry, row * LANES, min(max(there, limits[row]), limits[nx + row]))
    store(held, nx * LANES, count + 1.0)
