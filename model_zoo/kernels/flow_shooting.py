"""Free runs of a differential equation and their derivatives by all parameters and the initial state, compiled.

One step of the classical Runge-Kutta method a sample, its derivatives those of the step. Arrays and sizes are those of
`model_zoo.kernels.shooting`.
"""

from __future__ import annotations

import functools
from typing import Any

from model_zoo.kernels.shooting import look, push
from sysid_evo.engine.compiled.dialect import KernelSource, compile_kernel
from sysid_evo.engine.compiled.signature import WHOLES, Signature


@functools.cache
def compiled_flow_run() -> Any:
    """Return `flow_run`, compiled."""
    signature = Signature.of(flow_run, sizes=WHOLES, kinds=WHOLES)
    return compile_kernel(KernelSource(flow_run), signature, "float64", pointer=False)


@functools.cache
def compiled_flow_sensitivities() -> Any:
    """Return `flow_sensitivities`, compiled."""
    signature = Signature.of(flow_sensitivities, sizes=WHOLES, kinds=WHOLES)
    return compile_kernel(KernelSource(flow_sensitivities), signature, "float64", pointer=False)


def flow_run(sizes, outer, inner, kinds, pace, starts, controls, limit, states, room):
    """Write the states of free runs, kept within the limit; room: n + nu + 1 + 3 units, then 2 n."""
    pieces, steps, n, nu, units = sizes[0], sizes[1], sizes[2], sizes[3], sizes[4]
    width = n + nu + 1 + units
    rates = width + 2 * units
    trial = rates + n
    far = limit[0]
    for piece in range(pieces):
        at = piece * (steps + 1) * n
        for i in range(n):
            states[at + i] = starts[piece * n + i]
        for k in range(steps):
            for i in range(n):
                states[at + n + i] = states[at + i]
                room[rates + i] = 0.0
            for stage in range(4):
                for i in range(n):
                    room[trial + i] = states[at + i] + ahead(stage) * room[rates + i]
                look(room, trial, controls, (piece * steps + k) * nu, inner, kinds, n, nu, units, room)
                rate(outer, pace, n, width, room, rates)
                for i in range(n):
                    states[at + n + i] += weight(stage) * room[rates + i]
            for i in range(n):
                states[at + n + i] = min(max(states[at + n + i], -far), far)
            at += n


def flow_sensitivities(
    sizes,
    outer,
    inner,
    kinds,
    pace,
    starts,
    controls,
    counts,
    limit,
    states,
    derivatives,
    now,
    after,
    trials,
    pushed,
    room,
):
    """Write the states of free runs, and of the outputs the derivatives times the counts.

    room: n + nu + 1 + 3 units, n units, n n, and 2 n; now, after, trials, pushed: n (parameters + n).
    """
    pieces, steps, n, nu, units, ny = sizes[0], sizes[1], sizes[2], sizes[3], sizes[4], sizes[5]
    seen = n + nu + 1
    width = seen + units
    size = n * width + units * seen + n
    rates = width + 2 * units + n * units + n * n
    trial = rates + n
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
                    look(room, trial, controls, (piece * steps + k) * nu, inner, kinds, n, nu, units, room)
                    push(outer, inner, kinds, pace, n, seen, units, 0.0, trials, pushed, room)
                    rate(outer, pace, n, width, room, rates)
                    for i in range(n):
                        states[at + n + i] += weight(stage) * room[rates + i]
                    for j in range(n * size):
                        after[j] += weight(stage) * pushed[j]
                for i in range(n):
                    states[at + n + i] = min(max(states[at + n + i], -far), far)
                at += n
                for j in range(n * size):
                    now[j] = after[j]


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
