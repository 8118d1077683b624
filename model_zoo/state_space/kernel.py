"""Compiled step of several state spaces with one common output and an observer."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from model_zoo.state_space.units import BOUND, SHARP_WIDTH
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
)
from sysid_evo.models.kernels.stepping import copy
from sysid_evo.system import System
from sysid_evo.types import Array, IntArray, check_shape

HEAD = Layout("ny", "nu", "n", "members", "far", "limited", "output", "limits", "own", align=CACHE_LINE)
MEMBER = Layout("n", "units", "next", align=CACHE_LINE)

UNBOUNDED = 1e30
"""Larger than any rate."""


def state_space_kernel(
    system: System,
    outer: Sequence[Array],
    inner: Sequence[Array],
    kinds: Sequence[IntArray],
    *,
    output: Array,
    offset: Array,
    gain: Array,
    far: float,
    flow: bool,
) -> DynamicsKernel:
    """Return the kernel of a `StateSpaceModel`; with ``flow`` the weights give rates, see `flow_step`."""
    blocks, at, ny, total = [], 0, system.nx, sum(len(one) for one in outer)
    check_shape("offset", offset, (ny,))
    check_shape("output", output, (ny, total))
    check_shape("gain", gain, (total, ny))
    for own_outer, own_inner, own_kinds in zip(outer, inner, kinds, strict=True):
        n, count = len(own_outer), len(own_inner)
        check_shape("outer", own_outer, (n, n + system.nu + 1 + count))
        check_shape("inner", own_inner, (count, n + system.nu + 1))
        check_shape("kinds", own_kinds, (count,))
        numbers = padded(np.concatenate([own_kinds, own_inner.ravel(), own_outer.ravel(), gain[at : at + n].ravel()]))
        blocks.append(MEMBER.pack(numbers, n=n, units=count, next=MEMBER.size + len(numbers)))
        at += n
    parts = [
        padded(np.concatenate([offset, output.ravel()])),
        padded(np.ravel(system.limits) if system.limited else np.empty(0)),
    ]
    places = np.cumsum([HEAD.size, *(len(part) for part in parts)])
    parameters = HEAD.pack(
        *parts,
        *blocks,
        ny=system.nx,
        nu=system.nu,
        n=at,
        members=len(outer),
        far=far,
        limited=system.limited,
        output=places[0],
        limits=places[1],
        own=places[2],
    )
    widest = max((len(one) for one in inner), default=0)
    if flow:
        return DynamicsKernel(KernelSource(flow_step), parameters, 2 * system.nx + 3 * at + widest)
    return DynamicsKernel(KernelSource(step), parameters, system.nx + at + widest)


def flow_step(carry, control, noise, parameters, scratch):
    """Step every member by a Runge-Kutta step, correct by the output error, and write the output."""
    ny, nu, n = int(parameters[HEAD.ny]), int(parameters[HEAD.nu]), int(parameters[HEAD.n])
    states, fresh = view(carry, ny * LANES), view(scratch, ny * LANES)
    none, trial, slope = view(fresh, n * LANES), view(fresh, (n + ny) * LANES), view(fresh, (2 * n + ny) * LANES)
    room, output = view(fresh, (3 * n + ny) * LANES), view(parameters, int(parameters[HEAD.output]))
    off_by(carry, output, ny, n, scratch)
    for row in range(ny):
        store(none, row * LANES, splat(0.0))
    at, place, far = 0, int(parameters[HEAD.own]), parameters[HEAD.far]
    for _ in range(int(parameters[HEAD.members])):
        own = view(parameters, place)
        begin, after, count = view(states, at * LANES), view(fresh, at * LANES), int(own[MEMBER.n])
        copy(begin, trial, count * LANES)
        copy(begin, after, count * LANES)
        for stage in range(4):
            advance(trial, control, none, own, ny, nu, UNBOUNDED, slope, room)
            weight = 1.0 / 6.0 if stage == 0 or stage == 3 else 1.0 / 3.0
            ahead = 1.0 if stage == 2 else 0.5
            for row in range(count):
                rate = load(slope, row * LANES)
                store(after, row * LANES, load(after, row * LANES) + splat(weight) * rate)
                store(trial, row * LANES, load(begin, row * LANES) + splat(ahead) * rate)
        correct(after, scratch, own, ny, nu, far)
        at += count
        place += int(own[MEMBER.next])
    conclude(carry, parameters, ny, n, scratch)


def step(carry, control, noise, parameters, scratch):
    """Correct by the output error, step every member, and write the output."""
    ny, nu, n = int(parameters[HEAD.ny]), int(parameters[HEAD.nu]), int(parameters[HEAD.n])
    states, fresh = view(carry, ny * LANES), view(scratch, ny * LANES)
    room, output = view(scratch, (ny + n) * LANES), view(parameters, int(parameters[HEAD.output]))
    off_by(carry, output, ny, n, scratch)
    at, place, far = 0, int(parameters[HEAD.own]), parameters[HEAD.far]
    for _ in range(int(parameters[HEAD.members])):
        own = view(parameters, place)
        advance(view(states, at * LANES), control, scratch, own, ny, nu, far, view(fresh, at * LANES), room)
        at += int(own[MEMBER.n])
        place += int(own[MEMBER.next])
    conclude(carry, parameters, ny, n, scratch)


def off_by(carry, output, ny, n, off):
    """Write the differences between the outputs and those of the hidden states."""
    observe(view(carry, ny * LANES), output, ny, n, off)
    for row in range(ny):
        store(off, row * LANES, load(carry, row * LANES) - load(off, row * LANES))


def conclude(carry, parameters, ny, n, scratch):
    """Write the carry from the next hidden states, which follow the outputs in scratch."""
    observe(view(scratch, ny * LANES), view(parameters, int(parameters[HEAD.output])), ny, n, scratch)
    if parameters[HEAD.limited] > 0.0:
        limits = view(parameters, int(parameters[HEAD.limits]))
        for row in range(ny):
            there = load(scratch, row * LANES)
            store(scratch, row * LANES, min(max(there, limits[row]), limits[ny + row]))
    copy(scratch, carry, (ny + n) * LANES)


def observe(states, p, ny, n, y):
    """Write the outputs of all states; p: offsets, then one row of weights for each output."""
    for row in range(ny):
        out = splat(p[row])
        weights = view(p, ny + row * n)
        for i in range(n):
            out = out + weights[i] * load(states, i * LANES)
        store(y, row * LANES, out)


def advance(x, u, off, p, ny, nu, far, after, room):
    """Write the next states of one member, corrected by ``off``."""
    n, count = int(p[MEMBER.n]), int(p[MEMBER.units])
    seen = n + nu + 1
    width = seen + count
    first = MEMBER.size + count
    for j in range(count):
        weights = view(p, first + j * seen)
        inside = splat(weights[seen - 1])
        for i in range(n):
            inside = inside + weights[i] * load(x, i * LANES)
        for i in range(nu):
            inside = inside + weights[n + i] * load(u, i * LANES)
        kind = p[MEMBER.size + j]
        if kind == 0.0:
            store(room, j * LANES, math.tanh(inside))
        elif kind < 3.0:
            wide = 1.0 if kind == 1.0 else SHARP_WIDTH
            store(room, j * LANES, 0.5 * (math.sqrt(inside * inside + wide * wide) - wide))
        elif kind == 3.0:
            inside = min(max(inside, -BOUND), BOUND)
            store(room, j * LANES, inside * inside * inside * (1.0 / 3.0))
        else:
            store(room, j * LANES, min(max(inside, -BOUND), BOUND) * load(room, (j - 1) * LANES))
    outer, gain = view(p, first + count * seen), view(p, first + count * seen + n * width)
    for row in range(n):
        weights = view(outer, row * width)
        value = splat(weights[seen - 1])
        for i in range(n):
            value = value + weights[i] * load(x, i * LANES)
        for i in range(nu):
            value = value + weights[n + i] * load(u, i * LANES)
        for j in range(count):
            value = value + weights[seen + j] * load(room, j * LANES)
        for i in range(ny):
            value = value + gain[row * ny + i] * load(off, i * LANES)
        store(after, row * LANES, min(max(value, -far), far))


def correct(after, off, p, ny, nu, far):
    """Add the correction ``off`` to the next states of one member, and clip them to ``far``."""
    n, count = int(p[MEMBER.n]), int(p[MEMBER.units])
    seen = n + nu + 1
    gain = view(p, MEMBER.size + count + count * seen + n * (seen + count))
    for row in range(n):
        value = load(after, row * LANES)
        for i in range(ny):
            value = value + gain[row * ny + i] * load(off, i * LANES)
        store(after, row * LANES, min(max(value, -far), far))
