"""Compiled simulations of state spaces and their sensitivities, for training, independent of `SYSID_EVO_ENGINE`.

The spaces are `model_zoo.state_space.shooting.StateSpaceBatch`; all arrays are flat. ``sizes`` are the numbers of
windows, steps, states, controls, units and outputs. A step is that of a difference equation, or a classical Runge-Kutta
step per sample, with the derivatives of the step.
"""

from __future__ import annotations

import functools
import math
from typing import Any

from model_zoo.state_space.units import BOUND, SHARP_WIDTH
from sysid_evo.engine.compiled.compiler import compile_kernel
from sysid_evo.kernels import INTEGERS, KernelSource, Signature, view


@functools.cache
def compiled_run(*, flow: bool) -> Any:
    """Return `run` compiled, with ``flow`` for a differential equation."""
    return _compiled(KernelSource(run, {"step": flow_step} if flow else {}))


@functools.cache
def compiled_sensitivities(*, flow: bool) -> Any:
    """Return `sensitivities` compiled, with ``flow`` for a differential equation."""
    return _compiled(KernelSource(sensitivities, {"pushing_step": pushing_flow_step} if flow else {}))


def _compiled(source: KernelSource) -> Any:
    signature = Signature.of(source.function, sizes=INTEGERS, kinds=INTEGERS)
    return compile_kernel(source, signature, "float64", pointer=False)


def run(sizes, outer, inner, kinds, pace, starts, controls, limit, states, room):
    """Write the states of simulations, clipped to the limit; room: n + nu + 1 + 3 units, and that of `step`."""
    pieces, steps, n, nu, units = sizes[0], sizes[1], sizes[2], sizes[3], sizes[4]
    far = limit[0]
    for piece in range(pieces):
        at = piece * (steps + 1) * n
        for i in range(n):
            states[at + i] = starts[piece * n + i]
        for k in range(steps):
            place = (piece * steps + k) * nu
            step(states, at, controls, place, outer, inner, kinds, pace, n, nu, units, far, room)
            at += n


def sensitivities(
    sizes, outer, inner, kinds, pace, starts, controls, counts, limit, states, derivatives, now, after, room
):
    """Write the states of simulations, and the derivatives of the outputs times the counts.

    room: n + nu + 1 + 3 units, n units, n n, and that of `pushing_step`; now and after: n (parameters + n).
    """
    pieces, steps, n, nu, units, ny = sizes[0], sizes[1], sizes[2], sizes[3], sizes[4], sizes[5]
    seen = n + nu + 1
    size = n * (seen + units) + units * seen + n
    far = limit[0]
    for piece in range(pieces):
        at = piece * (steps + 1) * n
        for i in range(n):
            states[at + i] = starts[piece * n + i]
            for j in range(size):
                now[i * size + j] = 0.0
            now[i * size + size - n + i] = 1.0
        for k in range(steps + 1):
            row = piece * (steps + 1) + k
            for i in range(ny):
                for j in range(size):
                    derivatives[(row * ny + i) * size + j] = counts[row] * now[i * size + j]
            if k < steps:
                place = (piece * steps + k) * nu
                pushing_step(
                    states, at, controls, place, outer, inner, kinds, pace, n, nu, units, far, now, after, room
                )
                at += n
                for j in range(n * size):
                    now[j] = after[j]


def step(states, at, controls, place, outer, inner, kinds, pace, n, nu, units, far, room):
    """Write the next states after those at position ``at``."""
    look(states, at, controls, place, inner, kinds, n, nu, units, room)
    advance(states, at, outer, pace, n, n + nu + 1 + units, far, room)


def pushing_step(states, at, controls, place, outer, inner, kinds, pace, n, nu, units, far, now, after, room):
    """Write the next states after those at position ``at``, and the derivatives ``after`` from those ``now``."""
    seen = n + nu + 1
    look(states, at, controls, place, inner, kinds, n, nu, units, room)
    push(outer, inner, kinds, pace, n, seen, units, 1.0, now, after, room)
    advance(states, at, outer, pace, n, seen + units, far, room)


def push(outer, inner, kinds, pace, n, seen, units, kept, now, after, room):
    """Write the derivatives ``after`` of the rates from those ``now``, plus ``kept`` times those of the states."""
    width = seen + units
    before = n * width
    size = before + units * seen + n
    through = width + 2 * units
    by_state = through + n * units
    for i in range(n):
        for h in range(units):
            share = outer[i * width + seen + h] * room[width + h]
            if h + 1 < units and kinds[h + 1] == 4:
                share += outer[i * width + seen + h + 1] * room[width + units + h]
            room[through + i * units + h] = share
        for j in range(n):
            total = outer[i * width + j]
            for h in range(units):
                total += room[through + i * units + h] * inner[h * seen + j]
            room[by_state + i * n + j] = pace[i] * total
        room[by_state + i * n + i] += kept
    for i in range(n):
        for j in range(size):
            after[i * size + j] = 0.0
        for m in range(n):
            share = room[by_state + i * n + m]
            for j in range(size):
                after[i * size + j] += share * now[m * size + j]
        for j in range(width):
            after[i * size + i * width + j] += pace[i] * room[j]
        for h in range(units):
            share = pace[i] * room[through + i * units + h]
            for j in range(seen):
                after[i * size + before + h * seen + j] += share * room[j]


def look(states, at, controls, place, inner, kinds, n, nu, units, room):
    """Write states, controls, 1, the values of the units, their slopes, and their factors for gates."""
    seen = n + nu + 1
    width = seen + units
    for i in range(n):
        room[i] = states[at + i]
    for i in range(nu):
        room[n + i] = controls[place + i]
    room[n + nu] = 1.0
    for h in range(units):
        inside = 0.0
        for j in range(seen):
            inside += inner[h * seen + j] * room[j]
        if kinds[h] == 0:
            value = math.tanh(inside)
            slope = 1.0 - value * value
        elif kinds[h] < 3:
            wide = 1.0 if kinds[h] == 1 else SHARP_WIDTH
            root = math.sqrt(inside * inside + wide * wide)
            value = 0.5 * (root - wide)
            slope = 0.5 * inside / root
        elif kinds[h] == 3:
            inside = min(max(inside, -BOUND), BOUND)
            value = inside * inside * inside * (1.0 / 3.0)
            slope = inside * inside if abs(inside) < BOUND else 0.0
        else:
            before = room[seen + h - 1]
            slope = before if abs(inside) < BOUND else 0.0
            inside = min(max(inside, -BOUND), BOUND)
            value = before * inside
            room[width + units + h - 1] = room[width + h - 1] * inside
        room[seen + h] = value
        room[width + h] = slope


def advance(states, at, outer, pace, n, width, far, room):
    """Write the next states from the values of `look`."""
    for i in range(n):
        total = 0.0
        for j in range(width):
            total += outer[i * width + j] * room[j]
        states[at + n + i] = min(max(states[at + i] + pace[i] * total, -far), far)


def flow_step(states, at, controls, place, outer, inner, kinds, pace, n, nu, units, far, room):
    """Write the next states after those at position ``at``; needs 2 n of the room."""
    width = n + nu + 1 + units
    rates = width + 2 * units
    trial = rates + n
    for i in range(n):
        states[at + n + i] = states[at + i]
        room[rates + i] = 0.0
    for stage in range(4):
        for i in range(n):
            room[trial + i] = states[at + i] + ahead(stage) * room[rates + i]
        look(room, trial, controls, place, inner, kinds, n, nu, units, room)
        rate(outer, pace, n, width, room, rates)
        for i in range(n):
            states[at + n + i] += weight(stage) * room[rates + i]
    for i in range(n):
        states[at + n + i] = min(max(states[at + n + i], -far), far)


def pushing_flow_step(states, at, controls, place, outer, inner, kinds, pace, n, nu, units, far, now, after, room):
    """Write the next states after those at position ``at``, and the derivatives ``after`` from those ``now``.

    Needs 2 n and twice n (parameters + n) of the room.
    """
    seen = n + nu + 1
    width = seen + units
    size = n * width + units * seen + n
    rates = width + 2 * units + n * units + n * n
    trial = rates + n
    trials, pushed = view(room, trial + n), view(room, trial + n + n * size)
    for i in range(n):
        states[at + n + i] = states[at + i]
        room[rates + i] = 0.0
    for j in range(n * size):
        after[j] = now[j]
        pushed[j] = 0.0
    for stage in range(4):
        for i in range(n):
            room[trial + i] = states[at + i] + ahead(stage) * room[rates + i]
        for j in range(n * size):
            trials[j] = now[j] + ahead(stage) * pushed[j]
        look(room, trial, controls, place, inner, kinds, n, nu, units, room)
        push(outer, inner, kinds, pace, n, seen, units, 0.0, trials, pushed, room)
        rate(outer, pace, n, width, room, rates)
        for i in range(n):
            states[at + n + i] += weight(stage) * room[rates + i]
        for j in range(n * size):
            after[j] += weight(stage) * pushed[j]
    for i in range(n):
        states[at + n + i] = min(max(states[at + n + i], -far), far)


def ahead(stage):
    """Return the time of a stage in samples, along the rates of the stage before."""
    return 1.0 if stage == 3 else 0.5


def weight(stage):
    """Return the weight of the rates of a stage."""
    return 1.0 / 6.0 if stage == 0 or stage == 3 else 1.0 / 3.0


def rate(outer, pace, n, width, room, rates):
    """Write the rates from the values of `look`."""
    for i in range(n):
        total = 0.0
        for j in range(width):
            total += outer[i * width + j] * room[j]
        room[rates + i] = pace[i] * total
