"""The kernel of a model with uncertainty penalty: the compiled form of `sysid_evo.models.penalty.Penalised`."""

from __future__ import annotations

import math

import numpy as np

from sysid_evo.data.support import Support
from sysid_evo.kernels import (
    CACHE_LINE,
    LANES,
    DynamicsKernel,
    KernelSource,
    Layout,
    lanes_at_most,
    load,
    splat,
    store,
    view,
    where_at_most,
)
from sysid_evo.models.kernels.neighbours import neighbour_predictor

HEAD = Layout("nx", "nu", "penalty_at", "outside", "per_limit", "every", "table", "own", align=CACHE_LINE)


def penalised_kernel(
    model: DynamicsKernel, nu: int, *, penalty_at: int, outside: float, support: Support, every: int
) -> DynamicsKernel:
    """Return the kernel of ``model`` with penalty and countdown to the next comparison, at ``penalty_at``."""
    nx = len(support.scale) - nu
    found = neighbour_predictor([(support.points, support.points)], np.zeros(1, dtype=np.int64), [], range(nu), nx)
    parameters = HEAD.pack(
        1.0 / support.scale,
        nx=nx,
        nu=nu,
        penalty_at=penalty_at,
        outside=outside * every,
        per_limit=1.0 / support.limit,
        every=every,
        table=found.parameters,
        own=model.parameters,
    )
    source = KernelSource(penalised, {
        "inner": model.source, "look": KernelSource(look, {"nearest_pair": found.function}),
    })  # fmt: skip
    room = max(2 * (nx + nu) + found.n_scratch, model.n_scratch)
    return DynamicsKernel(source, parameters, room, model.precision)


def penalised(carry, control, noise, parameters, scratch):
    """Add the penalty for the distance from the data, and step the model."""
    every, penalty = parameters[HEAD.every], view(carry, int(parameters[HEAD.penalty_at]) * LANES)
    clock = load(penalty, LANES)
    if lanes_at_most(clock, splat(0.0)) != 0:
        look(carry, control, penalty, parameters, scratch)
    store(penalty, LANES, where_at_most(clock, 0.0, every, clock) - 1.0)
    inner(carry, control, noise, view(parameters, int(parameters[HEAD.own])), scratch)


def look(carry, control, penalty, parameters, scratch):
    """Add to the penalty of the lanes that are due."""
    nx, nu, scales = int(parameters[HEAD.nx]), int(parameters[HEAD.nu]), view(parameters, HEAD.size)
    here, commanded, found = scratch, view(scratch, nx * LANES), view(scratch, (nx + nu) * LANES)
    for row in range(nx):
        store(here, row * LANES, load(carry, row * LANES) * scales[row])
    for row in range(nu):
        store(commanded, row * LANES, load(control, row * LANES) * scales[nx + row])
    table = view(parameters, int(parameters[HEAD.table]))
    nearest_pair(here, commanded, table, found, view(found, (nx + nu) * LANES))
    square = splat(0.0)
    for row in range(nx + nu):
        off = load(here, row * LANES) - load(found, row * LANES)
        square = square + off * off
    beyond = min(max(math.sqrt(square) * parameters[HEAD.per_limit] - 1.0, 0.0), 1.0)
    counted = where_at_most(load(penalty, LANES), 0.0, parameters[HEAD.outside] * beyond, 0.0)
    store(penalty, 0, load(penalty, 0) + counted)
