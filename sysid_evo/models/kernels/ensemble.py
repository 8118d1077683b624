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
)
from sysid_evo.models.kernels.stepping import copy
from sysid_evo.system import System
from sysid_evo.types import Array, check_shape

MEAN = Layout("nx", "count", "chain", align=CACHE_LINE)


def mean_kernel(
    members: Sequence[DynamicsKernel],
    system: System,
    *,
    places: Sequence[int],
    noise_places: Sequence[int],
    weights: Array,
) -> DynamicsKernel:
    """Return the kernel of a weighted mean of next states, which becomes the state of every member.

    The carry is the state and the members' carries at ``places``.
    """
    chain = chained(members, system.nx, places, noise_places)
    weights = check_shape("weights", weights, (len(members),))
    parameters = MEAN.pack(weights, places, nx=system.nx, count=len(members), chain=chain.parameters)
    source = KernelSource(averaged, {"step_all": chain.source})
    return DynamicsKernel(source, parameters, chain.n_scratch, chain.precision)


def averaged(carry, control, noise, parameters, scratch):
    """Step all members and set their states to the mean."""
    nx, count = int(parameters[MEAN.nx]), int(parameters[MEAN.count])
    weights, places = view(parameters, MEAN.size), view(parameters, MEAN.size + count)
    step_all(carry, control, noise, view(parameters, int(parameters[MEAN.chain])), scratch)
    for row in range(nx):
        total = splat(0.0)
        for member in range(count):
            total = total + weights[member] * load(carry, (int(places[member]) + row) * LANES)
        store(carry, row * LANES, total)
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
