"""Several kernels that step from one state, and their mean."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

import numpy as np

from sysid_evo.kernels import (
    CACHE_LINE,
    LANES,
    DynamicsKernel,
    KernelSource,
    Layout,
    Precision,
    load,
    padded,
    splat,
    store,
    view,
    where_at_most,
)
from sysid_evo.models.kernels.stepping import copy
from sysid_evo.system import System
from sysid_evo.types import Array, check_shape

MEAN = Layout("nx", "nu", "count", "watched", "held", "rest", "chain", align=CACHE_LINE)


def mean_kernel(
    members: Sequence[DynamicsKernel],
    system: System,
    *,
    places: Sequence[int],
    noise_places: Sequence[int],
    weights: Array,
    dead_band_size: Array | None = None,
    watched: Sequence[int] = (),
) -> DynamicsKernel:
    """Return the kernel of a weighted mean of next states, which becomes the state of every member.

    The carry is the state and the members' carries at ``places``. With ``dead_band_size`` (nx,) a state within this
    band around neutral becomes neutral under neutral control, if the earlier controls, in the ``watched`` rows of the
    carry, are neutral too.
    """
    nx, chain = system.nx, chained(members, system.nx, places, noise_places)
    rest, rows = np.empty(0), watched if dead_band_size is not None else ()
    if dead_band_size is not None:
        idle = system.neutral_control
        rest = np.concatenate([dead_band_size, system.neutral_state, idle, rows, np.resize(idle, len(rows))])
    weights = check_shape("weights", weights, (len(members),))
    numbers, at_rest = padded(np.concatenate([weights, places])), padded(rest)
    parameters = MEAN.pack(
        numbers,
        at_rest,
        chain.parameters,
        nx=nx,
        nu=system.nu,
        count=len(members),
        watched=len(rows),
        held=dead_band_size is not None,
        rest=MEAN.size + len(numbers),
        chain=MEAN.size + len(numbers) + len(at_rest),
    )
    source = KernelSource(averaged, {"step_all": chain.source})
    return DynamicsKernel(source, parameters, chain.n_scratch + 1, chain.precision)


def averaged(carry, control, noise, parameters, scratch):
    """Step all members and set their states to the mean, or to neutral in the dead band."""
    nx, nu, count = int(parameters[MEAN.nx]), int(parameters[MEAN.nu]), int(parameters[MEAN.count])
    weights, places = view(parameters, MEAN.size), view(parameters, MEAN.size + count)
    rest, held = view(parameters, int(parameters[MEAN.rest])), parameters[MEAN.held]
    if held > 0.0:
        neutral, idle, watched = view(rest, nx), view(rest, 2 * nx), int(parameters[MEAN.watched])
        rows, values = view(rest, 2 * nx + nu), view(rest, 2 * nx + nu + watched)
        moves = splat(0.0)
        for row in range(nu):
            moves = moves + abs(load(control, row * LANES) - idle[row])
        for i in range(watched):
            moves = moves + abs(load(carry, int(rows[i]) * LANES) - values[i])
        for row in range(nx):
            moves = where_at_most(abs(load(carry, row * LANES) - neutral[row]), rest[row], moves, 1.0)
        store(scratch, 0, moves)
    step_all(carry, control, noise, view(parameters, int(parameters[MEAN.chain])), view(scratch, LANES))
    for row in range(nx):
        total = splat(0.0)
        for member in range(count):
            total = total + weights[member] * load(carry, (int(places[member]) + row) * LANES)
        store(carry, row * LANES, total)
    if held > 0.0:
        for row in range(nx):
            mean = load(carry, row * LANES)
            store(carry, row * LANES, where_at_most(load(scratch, 0), 0.0, rest[nx + row], mean))
    for member in range(count):
        copy(carry, view(carry, int(places[member]) * LANES), nx * LANES)


GROUP, MEMBER = Layout("nx", "count", "next"), Layout("at", "noise_at", "own")


def chained(
    members: Sequence[DynamicsKernel], nx: int, places: Sequence[int], noise_places: Sequence[int]
) -> DynamicsKernel:
    """Return a kernel that copies the state at the head of the carry into each member's carry, and steps them all.

    Members with the same code are in one loop, so that it is compiled once.
    """
    source, parameters = KernelSource(nothing_to_step), np.zeros(1)
    groups = [list(group) for _, group in groupby(range(len(members)), key=lambda i: members[i].source)]
    for group in reversed(groups):
        begin = -(-(GROUP.size + MEMBER.size * len(group)) // CACHE_LINE) * CACHE_LINE
        heads, blocks = [], []
        for i in group:
            heads.append(MEMBER.pack(at=places[i], noise_at=noise_places[i], own=begin))
            blocks.append(padded(members[i].parameters))
            begin += len(blocks[-1])
        head = padded(GROUP.pack(*heads, nx=nx, count=len(group), next=begin))
        parameters = np.concatenate([head, *blocks, parameters])
        source = KernelSource(step_group, {"one": members[group[0]].source, "others": source})
    precision: Precision = "float64" if any(member.precision == "float64" for member in members) else "float32"
    return DynamicsKernel(source, parameters, max((member.n_scratch for member in members), default=0), precision)


def step_group(carry, control, noise, parameters, scratch):
    """Step the members of one code, then the others."""
    rows = int(parameters[GROUP.nx]) * LANES
    for number in range(int(parameters[GROUP.count])):
        head = view(parameters, GROUP.size + number * MEMBER.size)
        own = view(carry, int(head[MEMBER.at]) * LANES)
        copy(carry, own, rows)
        drawn = view(noise, int(head[MEMBER.noise_at]) * LANES)
        one(own, control, drawn, view(parameters, int(head[MEMBER.own])), scratch)
    others(carry, control, noise, view(parameters, int(parameters[GROUP.next])), scratch)


def nothing_to_step(carry, control, noise, parameters, scratch):
    """Change nothing."""
    return
