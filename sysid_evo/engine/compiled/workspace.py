"""Memory of compiled loops: named slots of one piece, tables of switches, limits and noise.

A load across two cache lines costs twice. And some processors find a line of the first-level cache by a hash of
its address, so that two pages that lie far apart may drive each other out of it at every step, in one process and
not in the next; pages that follow each other never do.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from sysid_evo.kernels import LANES, QUARTER, Precision
from sysid_evo.system import System, level_boundaries
from sysid_evo.types import Array

CACHE_LINE = 64
"""Bytes."""
SMALL = 1 << 14
"""Numbers of an array that is copied beside a thread's own ones."""


def empty_lines(count: int, real: Any) -> Any:
    """Return ``count`` zeros, at least one, that begin on a cache line."""
    count, itemsize = max(1, count), np.dtype(real).itemsize
    room = np.zeros(count + CACHE_LINE // itemsize, real)
    first = -room.__array_interface__["data"][0] % CACHE_LINE // itemsize
    return room[first : first + count]


def aligned(array: Any, real: Any = None) -> Any:
    """Return a flat copy of ``array`` from a cache line on, in another precision if ``real`` is given."""
    copied = empty_lines(array.size, real or array.dtype)
    with np.errstate(over="ignore"):  # a number beyond float32 is infinite
        copied[: array.size].reshape(array.shape)[...] = array
    return copied


def together(sizes: Mapping[str, int], real: Any, *, copies: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return arrays of zeros of the ``sizes``, one after the other in memory, each from a cache line on.

    Of the ``copies``, flat arrays of the same precision, the small ones are copied behind them and the others
    returned as they are.
    """
    copies = copies or {}
    near = {name: array for name, array in copies.items() if array.size <= SMALL}
    per_line = CACHE_LINE // np.dtype(real).itemsize
    counts = {**sizes, **{name: array.size for name, array in near.items()}}
    wholes = {name: -(-max(1, count) // per_line) * per_line for name, count in counts.items()}
    room, first = empty_lines(sum(wholes.values()), real), 0
    placed: dict[str, Any] = dict(copies)
    for name, whole in wholes.items():
        placed[name] = room[first : first + max(1, counts[name])]
        first += whole
    for name, array in near.items():
        placed[name][:] = array
    return placed


def actuation_table(system: System, precision: Precision, *, before_tanh: bool = False) -> Array:
    """Return `System.actuate` as numbers: the width of a row, then one row a control.

    ``[count, low, high, level 0, level 1, boundary 1, level 2, boundary 2, ...]``; count 0 is continuous, -1 too,
    but of an output that is still to be squashed (``before_tanh``); boundaries are then those before tanh. A boundary
    belongs to the level nearer to zero, so that a negative one is the last number of ``precision`` below it.
    """
    most = max((len(channel.levels) for channel in system.controls if channel.levels), default=0)
    system.actuate(np.zeros(system.nu))  # raises for a control that has neither limits nor levels
    table = np.zeros((system.nu, 4 + 2 * most))
    for row, channel in zip(table, system.controls, strict=True):
        row[0], row[1], row[2] = -1.0 if before_tanh else 0.0, channel.low, channel.high
        if channel.levels is not None:
            row[0], row[3] = len(channel.levels), channel.levels[0]
            for i, boundary in enumerate(level_boundaries(len(channel.levels)), start=1):
                bound = np.array(np.arctanh(boundary) if before_tanh else boundary, precision)
                row[2 + 2 * i] = channel.levels[i]
                row[3 + 2 * i] = np.nextafter(bound, -np.inf, dtype=precision) if boundary < 0.0 else bound
    return np.concatenate([[table.shape[1]], table.ravel()])


def bounds_table(state_bounds: Array | None, nx: int, precision: Precision) -> Array:
    """Return the lowest and the highest value of each state, none infinite, and the largest number of ``precision``."""
    most = np.finfo(precision).max
    limits = np.full((2, nx), np.inf) * [[-1.0], [1.0]] if state_bounds is None else state_bounds
    return np.append(np.clip(limits, -most, most), most)


def noise_table(noise: Array, precision: Precision) -> Any:
    """Return ``noise`` (E, steps, n_noise) as the loop reads it, flat.

    Of up to sixteen trials it is (steps, n_noise, 16), and every lane looks up that of its trial; of more it is
    (steps, n_noise, E + LANES), the trials in order, again and again, so that any 64 rollouts that follow each
    other find theirs in one piece.
    """
    trials, steps, n_noise = noise.shape
    if not n_noise:
        return empty_lines(0, precision)
    by_trial = noise.reshape(trials, -1).T
    if trials <= QUARTER:
        found = empty_lines(steps * n_noise * QUARTER, precision)
        found.reshape(-1, QUARTER)[:, :trials] = by_trial
        return found
    found = empty_lines(steps * n_noise * (trials + LANES), precision)
    in_order = np.arange(trials + LANES) % trials
    ordered = found.reshape(-1, trials + LANES)
    np.take(np.ascontiguousarray(by_trial, dtype=precision), in_order, axis=1, out=ordered, mode="clip")
    return found
