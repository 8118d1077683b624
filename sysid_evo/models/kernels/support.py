"""A kernel that counts steps outside its data, see `sysid_evo.models.Supported`."""

from __future__ import annotations

import math

import numpy as np

from sysid_evo.data.support import Support
from sysid_evo.kernels import CACHE_LINE, LANES, DynamicsKernel, KernelSource, Layout, padded, view
from sysid_evo.models.kernels.neighbours import neighbour_predictor

HEAD = Layout(
    "nx", "nu", "doubt_at", "clock_at", "weight", "every", "per_limit", "inner", "table", align=CACHE_LINE
)  # fmt: skip


def supported_kernel(
    inner: DynamicsKernel, support: Support, *, doubt_at: int, clock_at: int, weight: float, every: int, limit: float
) -> DynamicsKernel:
    """Return the kernel of ``inner`` that adds to its doubt, and counts down to the next look."""
    nx, nu = support.system.nx, support.system.nu
    table = neighbour_predictor([(support.points, support.points)], np.zeros(1, dtype=np.int64), [], range(nu), nx)
    scales, own = padded(1.0 / support.scale), padded(inner.parameters)
    parameters = HEAD.pack(
        scales,
        own,
        table.parameters,
        nx=nx,
        nu=nu,
        doubt_at=doubt_at,
        clock_at=clock_at,
        weight=weight * every,
        every=every,
        per_limit=1.0 / limit,
        inner=HEAD.size + len(scales),
        table=HEAD.size + len(scales) + len(own),
    )
    room = max(inner.n_scratch, 1 + 2 * (nx + nu) + table.n_scratch)
    bindings = {"inner": inner.source, "look": KernelSource(look, {"nearest_pair": table.function})}
    return DynamicsKernel(KernelSource(supported, bindings), parameters, room, inner.precision)


def supported(carry, control, noise, parameters, scratch):
    """Look, where a look is due, how far state and control lie from the data; then step the inner dynamics."""
    clock = view(carry, int(parameters[HEAD.clock_at]) * LANES)
    due = 0
    for lane in range(LANES):
        due += 1 if clock[lane] == 0.0 else 0
    if due > 0:
        look(carry, control, clock, view(carry, int(parameters[HEAD.doubt_at]) * LANES), parameters, scratch)
    every = parameters[HEAD.every]
    for lane in range(LANES):
        clock[lane] = (every if clock[lane] == 0.0 else clock[lane]) - 1.0
    inner(carry, control, noise, view(parameters, int(parameters[HEAD.inner])), scratch)


def look(carry, control, clock, doubt, parameters, scratch):
    """Add to the doubt of the lanes that are due."""
    nx, nu, scales = int(parameters[HEAD.nx]), int(parameters[HEAD.nu]), view(parameters, HEAD.size)
    square, here = scratch, view(scratch, LANES)
    commanded, found = view(here, nx * LANES), view(here, (nx + nu) * LANES)
    for row in range(nx):
        value, scaled, factor = view(carry, row * LANES), view(here, row * LANES), scales[row]
        for lane in range(LANES):
            scaled[lane] = value[lane] * factor
    for row in range(nu):
        value, scaled, factor = view(control, row * LANES), view(commanded, row * LANES), scales[nx + row]
        for lane in range(LANES):
            scaled[lane] = value[lane] * factor
    table = view(parameters, int(parameters[HEAD.table]))
    nearest_pair(here, commanded, table, found, view(found, (nx + nu) * LANES))
    for lane in range(LANES):
        square[lane] = 0.0
    for row in range(nx + nu):
        one, other = view(here, row * LANES), view(found, row * LANES)
        for lane in range(LANES):
            square[lane] += (one[lane] - other[lane]) * (one[lane] - other[lane])
    weight, per_limit = parameters[HEAD.weight], parameters[HEAD.per_limit]
    for lane in range(LANES):
        beyond = min(max(math.sqrt(square[lane]) * per_limit - 1.0, 0.0), 1.0)
        doubt[lane] += weight * beyond if clock[lane] == 0.0 else 0.0
