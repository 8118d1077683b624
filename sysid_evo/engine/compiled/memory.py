"""Memory that kernels work on: it begins on cache lines, and what is used together lies together.

A load across two cache lines costs twice. And some processors find a line of the first-level cache by a hash of
its address, so that two pages that lie far apart may drive each other out of it at every step, in one process and
not in the next; pages that follow each other never do.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

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
