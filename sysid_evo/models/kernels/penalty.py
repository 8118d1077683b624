"""The kernel of a model with uncertainty penalty: the compiled form of `sysid_evo.models.penalty.Penalised`."""

from __future__ import annotations

import math
from collections.abc import Sequence

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
    padded,
    splat,
    store,
    view,
    where_at_most,
)
from sysid_evo.models.kernels.ensemble import chained
from sysid_evo.models.kernels.neighbours import neighbour_predictor
from sysid_evo.models.kernels.stepping import copy
from sysid_evo.types import Array

HEAD = Layout(
    "nx", "nu", "penalty_at", "outside", "per_limit", "every", "disagreement", "others", "chain", "table", "own",
    align=CACHE_LINE,
)  # fmt: skip


def penalised_kernel(
    members: Sequence[DynamicsKernel],
    sizes: tuple[int, int],
    places: Sequence[int],
    noise_places: Sequence[int],
    *,
    penalty_at: int,
    outside: float,
    support: Support | None,
    every: int,
    disagreement: float,
    limit: Array,
) -> DynamicsKernel:
    """Return the kernel of the first of the ``members`` with penalty and countdown to the next comparison.

    ``sizes`` are nx and nu; carry and noise of the members begin at ``places`` and ``noise_places``. Without
    ``support`` there is no comparison with data; the difference between models is in units of ``limit`` (nx,).
    """
    nx, nu = sizes
    chain = chained(members[1:], nx, places[1:], noise_places[1:])
    scales, table, room, bindings = np.ones(nx + nu), np.zeros(1), 0, {"look": KernelSource(nothing_to_see)}
    if support is not None:
        found = neighbour_predictor([(support.points, support.points)], np.zeros(1, dtype=np.int64), [], range(nu), nx)
        scales, table, room = 1.0 / support.scale, found.parameters, 2 * (nx + nu) + found.n_scratch
        bindings = {"look": KernelSource(look, {"nearest_pair": found.function})}
    parts = [padded(np.concatenate([scales, 1.0 / limit, places[1:]])), padded(chain.parameters), padded(table)]
    ends = HEAD.size + np.cumsum([len(part) for part in parts])
    parameters = HEAD.pack(
        *parts,
        members[0].parameters,
        nx=nx,
        nu=nu,
        penalty_at=penalty_at,
        outside=outside * every,
        per_limit=0.0 if support is None else 1.0 / support.limit,
        every=0 if support is None else every,
        disagreement=disagreement,
        others=len(members) - 1,
        chain=ends[0],
        table=ends[1],
        own=ends[2],
    )
    source = KernelSource(penalised, {"inner": members[0].source, "step_all": chain.source, **bindings})
    room = max(room, chain.n_scratch, members[0].n_scratch)
    exact = any(member.precision == "float64" for member in members)
    return DynamicsKernel(source, parameters, room, "float64" if exact else "float32")


def penalised(carry, control, noise, parameters, scratch):
    """Add the penalty for the distance from the data, step all members, and add that for their disagreement."""
    nx, others, every = int(parameters[HEAD.nx]), int(parameters[HEAD.others]), parameters[HEAD.every]
    penalty, numbers = view(carry, int(parameters[HEAD.penalty_at]) * LANES), view(parameters, HEAD.size)
    if every > 0.0:
        clock = load(penalty, LANES)
        if lanes_at_most(clock, splat(0.0)) != 0:
            look(carry, control, penalty, parameters, scratch)
        store(penalty, LANES, where_at_most(clock, 0.0, every, clock) - 1.0)
    step_all(carry, control, noise, view(parameters, int(parameters[HEAD.chain])), scratch)
    inner(carry, control, noise, view(parameters, int(parameters[HEAD.own])), scratch)
    if others > 0:
        per_limit = view(numbers, nx + int(parameters[HEAD.nu]))
        places, farthest = view(per_limit, nx), splat(0.0)
        for row in range(nx):
            low = load(carry, row * LANES)
            high = low
            for member in range(others):
                there = load(carry, (int(places[member]) + row) * LANES)
                low, high = min(low, there), max(high, there)
            farthest = max(farthest, (high - low) * per_limit[row])
        beyond = min(max(farthest - 1.0, 0.0), 1.0)
        store(penalty, 0, load(penalty, 0) + parameters[HEAD.disagreement] * beyond)
        for member in range(others):
            copy(carry, view(carry, int(places[member]) * LANES), nx * LANES)


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


def nothing_to_see(carry, control, penalty, parameters, scratch):
    """Do not change the penalty."""
    return
