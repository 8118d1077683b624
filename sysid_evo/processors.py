"""How many processors the work of this process may use, and the limits that it sets for the libraries inside."""

from __future__ import annotations

import os

INNER_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
"""Libraries work on one thread: the matrices are small, and the engine spreads its blocks over all processors.
They read these variables when they are imported."""


class _Share:
    """How many of the processors were given to this process; 0 for all that it may use."""

    count = 0


def available_processors() -> int:
    """Return how many processors this process may use: its share, if it was given one."""
    return _Share.count or usable_processors()


def usable_processors() -> int:
    """Return on how many processors the system lets this process run."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def use_processors(count: int) -> None:
    """Let what begins from now on in this process use ``count`` processors; 0 for all. No result depends on it."""
    _Share.count = count
