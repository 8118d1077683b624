"""Spearman's rank correlation; importing `scipy.stats`, which has it, takes a second."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sysid_evo.arrays import Array

FEWEST = 3
"""Pairs; two are always in order."""


def rank_correlation(pairs: Sequence[tuple[float, float]]) -> float | None:
    """Return Spearman's correlation, None for fewer than three pairs or where one side is all equal."""
    first, second = [a for a, _ in pairs], [b for _, b in pairs]
    if len(pairs) < FEWEST or len(set(first)) < 2 or len(set(second)) < 2:
        return None
    return float(np.corrcoef(mean_ranks(first), mean_ranks(second))[0, 1])


def mean_ranks(values: Sequence[float]) -> Array:
    """Return the rank (n,) of each of ``values``, from 1; equal ones share the mean of theirs."""
    _, place, count = np.unique(values, return_inverse=True, return_counts=True)
    ranks: Array = np.cumsum(count) - 0.5 * (count - 1.0)
    return ranks[place]
