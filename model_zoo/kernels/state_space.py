"""State spaces side by side behind one output, with an observer, over lanes: the step of `model_zoo.hidden.family`."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from model_zoo.hidden.units import BOUND, SHARP
from sysid_evo.arrays import Array, IntArray
from sysid_evo.engine.compiled.dialect import KernelSource
from sysid_evo.engine.compiled.kernel import DynamicsKernel
from sysid_evo.engine.compiled.lanes import LANES, load, splat, store, view, where_at_most
from sysid_evo.engine.compiled.layout import CACHE_LINE, Layout, padded
from sysid_evo.engine.kernels.stepping import copy
from sysid_evo.system import System

HEAD = Layout("ny", "nu", "n", "members", "far", "held", "limited", "output", "rest", "limits", "own", align=CACHE_LINE)
MEMBER = Layout("n", "units", "next", align=CACHE_LINE)


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
    rest: Array | None,
) -> DynamicsKernel:
    """Return the kernel of a `StateSpaceModel`; ``rest`` is band, hidden band, neutral state, hidden rest, control."""
    blocks, at = [], 0
    for own_outer, own_inner, own_kinds in zip(outer, inner, kinds, strict=True):
        n, count = len(own_outer), len(own_inner)
        numbers = padded(np.concatenate([own_kinds, own_inner.ravel(), own_outer.ravel(), gain[at : at + n].ravel()]))
        blocks.append(MEMBER.pack(numbers, n=n, units=count, next=MEMBER.size + len(numbers)))
        at += n
    parts = [
        padded(np.concatenate([offset, output.ravel()])),
        padded(np.empty(0) if rest is None else rest),
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
        held=rest is not None,
        limited=system.limited,
        output=places[0],
        rest=places[1],
        limits=places[2],
        own=places[3],
    )
    widest = max((len(one) for one in inner), default=0)
    return DynamicsKernel(KernelSource(step), parameters, system.nx + at + widest)


def step(carry, control, noise, parameters, scratch):
    """Correct by what the output is off, step every member, and write the output."""
    ny, nu, n = int(parameters[HEAD.ny]), int(parameters[HEAD.nu]), int(parameters[HEAD.n])
    states, fresh = view(carry, ny * LANES), view(scratch, ny * LANES)
    room, output = view(scratch, (ny + n) * LANES), view(parameters, int(parameters[HEAD.output]))
    observe(states, output, ny, n, scratch)
    for row in range(ny):
        store(scratch, row * LANES, load(carry, row * LANES) - load(scratch, row * LANES))
    at, place, far = 0, int(parameters[HEAD.own]), parameters[HEAD.far]
    for _ in range(int(parameters[HEAD.members])):
        own = view(parameters, place)
        advance(view(states, at * LANES), control, scratch, own, ny, nu, far, view(fresh, at * LANES), room)
        at += int(own[MEMBER.n])
        place += int(own[MEMBER.next])
    observe(fresh, output, ny, n, scratch)
    if parameters[HEAD.limited] > 0.0:
        limits = view(parameters, int(parameters[HEAD.limits]))
        for row in range(ny):
            there = load(scratch, row * LANES)
            store(scratch, row * LANES, min(max(there, limits[row]), limits[ny + row]))
    if parameters[HEAD.held] > 0.0:
        hold(carry, control, view(parameters, int(parameters[HEAD.rest])), ny + n, nu, scratch)
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
            wide = 1.0 if kind == 1.0 else SHARP
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


def hold(carry, control, p, rows, nu, after):
    """Put the lanes that rest under neutral control back to rest; p: bands, what rests (rows each), the control."""
    moves = splat(0.0)
    for row in range(nu):
        moves = moves + abs(load(control, row * LANES) - p[2 * rows + row])
    for row in range(rows):
        moves = where_at_most(abs(load(carry, row * LANES) - p[rows + row]), p[row], moves, 1.0)
    for row in range(rows):
        store(after, row * LANES, where_at_most(moves, 0.0, p[rows + row], load(after, row * LANES)))
