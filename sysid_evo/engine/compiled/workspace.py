"""Memory of compiled loops: arrays in one contiguous block, tables of actuation, bounds and noise.

A load across two cache lines takes twice as long. Some processors index the first-level cache by a hash of the
address, so two distant pages may evict each other at every step, in one process and not in the next. Contiguous pages
never do.
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
"""An array of at most this many numbers is copied next to a thread's own arrays."""


def empty_lines(count: int, real: Any) -> Any:
    """Return ``count`` zeros (at least one) that begin on a cache line."""
    count, itemsize = max(1, count), np.dtype(real).itemsize
    memory = np.zeros(count + CACHE_LINE // itemsize, real)
    first = -memory.__array_interface__["data"][0] % CACHE_LINE // itemsize
    return memory[first : first + count]


def aligned(array: Any, real: Any = None) -> Any:
    """Return a flat copy of ``array`` that begins on a cache line, in the precision ``real`` if given."""
    copied = empty_lines(array.size, real or array.dtype)
    with np.errstate(over="ignore"):  # a number beyond float32 is infinite
        copied[: array.size].reshape(array.shape)[...] = array
    return copied


def together(sizes: Mapping[str, int], real: Any, *, copies: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return arrays of zeros of the ``sizes``, contiguous in memory, each beginning on a cache line.

    ``copies`` are flat arrays of the same precision: small ones are copied into the same block, large ones are returned
    unchanged.
    """
    copies = copies or {}
    small = {name: array for name, array in copies.items() if array.size <= SMALL}
    per_line = CACHE_LINE // np.dtype(real).itemsize
    counts = {**sizes, **{name: array.size for name, array in small.items()}}
    padded = {name: -(-max(1, count) // per_line) * per_line for name, count in counts.items()}
    memory, first = empty_lines(sum(padded.values()), real), 0
    placed: dict[str, Any] = dict(copies)
    for name, length in padded.items():
        placed[name] = memory[first : first + max(1, counts[name])]
        first += length
    for name, array in small.items():
        placed[name][:] = array
    return placed


def actuation_table(system: System, precision: Precision, *, before_tanh: bool = False) -> Array:
    """Return `System.actuate` as a table: the width of a row, then one row for each control.

    A row is ``[count, low, high, level 0, level 1, boundary 1, level 2, boundary 2, ...]``. Count 0 is a continuous
    control; -1 is one whose output still needs tanh (``before_tanh``), with boundaries before tanh. A boundary belongs
    to the level nearer to zero, so a negative boundary is stored as the next lower number of ``precision``.
    """
    max_levels = max((len(channel.levels) for channel in system.controls if channel.levels), default=0)
    system.actuate(np.zeros(system.nu))  # raises for a control that has neither limits nor levels
    table = np.zeros((system.nu, 4 + 2 * max_levels))
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
    """Return the lower bounds, then the upper bounds of the states (all finite), then the largest finite number."""
    largest = np.finfo(precision).max
    limits = np.full((2, nx), np.inf) * [[-1.0], [1.0]] if state_bounds is None else state_bounds
    return np.append(np.clip(limits, -largest, largest), largest)


def noise_table(noise: Array, precision: Precision) -> Any:
    """Return ``noise`` (E, steps, n_noise) in the layout of the loop, flat.

    For at most 16 trials the layout is (steps, n_noise, 16), and each lane looks up the noise of its trial. For more
    trials it is (steps, n_noise, E + LANES), the trials repeated in order, so that the noise of 64 consecutive
    rollouts is contiguous.
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
