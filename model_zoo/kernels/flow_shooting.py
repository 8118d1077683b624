"""Free runs of a differential equation and their derivatives by all parameters and the initial state, compiled.

Those of `model_zoo.kernels.shooting` with another step: one of the classical Runge-Kutta method a sample, its
derivatives those of the step.
"""

from __future__ import annotations

import functools
from typing import Any

from model_zoo.kernels.shooting import look, push, run, sensitivities
from sysid_evo.engine.compiled.dialect import compile_kernel
from sysid_evo.kernels import WHOLES, KernelSource, Signature, view


@functools.cache
def compiled_flow_run() -> Any:
    """Return `run` of a differential equation, compiled."""
    signature = Signature.of(run, sizes=WHOLES, kinds=WHOLES)
    return compile_kernel(KernelSource(run, {"step": flow_step}), signature, "float64", pointer=False)


@functools.cache
def compiled_flow_sensitivities() -> Any:
    """Return `sensitivities` of a differential equation, compiled."""
    signature = Signature.of(sensitivities, sizes=WHOLES, kinds=WHOLES)
    source = KernelSource(sensitivities, {"pushing_step": pushing_flow_step})
    return compile_kernel(source, signature, "float64", pointer=False)


def flow_step(states, at, controls, place, outer, inner, kinds, pace, n, nu, units, far, room):
    """Write the states after those at a place; takes 2 n of the room."""
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
    """Write the states after those at a place, and the derivatives after those now.

    Takes 2 n and twice n (parameters + n) of the room.
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
    """Return how far a stage looks ahead along the rates of the one before, in samples."""
    return 1.0 if stage == 3 else 0.5


def weight(stage):
    """Return what the rates of a stage count."""
    return 1.0 / 6.0 if stage == 0 or stage == 3 else 1.0 / 3.0


def rate(outer, pace, n, width, room, rates):
    """Write the rates at the place where `look` looked."""
    for i in range(n):
        total = 0.0
        for j in range(width):
            total += outer[i * width + j] * room[j]
        room[rates + i] = pace[i] * total
