"""Which recorded steps stand for all others in a sparse Gaussian process."""

from __future__ import annotations

import numpy as np

from sysid_evo.arrays import Array, IntArray

POOL = 3000
"""Random steps among which is chosen."""
LEAST = 1e-10
"""Variance, as a share of the prior's, up to which a step is as good as known: what is left of it is rounding."""


def inducing_rows(inputs: Array, lengths: Array, count: int, rng: np.random.Generator) -> IntArray:
    """Return ``count`` rows of ``inputs`` (N, n), sorted: half at random, the others where least is known beside them.

    That is where the variances which K processes with ``lengths`` (K, n) and amplitude 1 leave, given those chosen
    before, have the largest sum (pivoted Cholesky; Burt, Rasmussen, van der Wilk 2020, section 4.2.2). Chosen so alone,
    outliers would be most of them.
    """
    pool = rng.choice(len(inputs), size=min(POOL, len(inputs)), replace=False)
    count = min(count, len(pool))
    near, few = inputs[pool], count // 2
    left = np.ones((len(lengths), len(pool)))
    factors = np.zeros((len(lengths), count, len(pool)))
    chosen: list[int] = []
    for number in range(count):
        row = number if number < few else int(np.argmax(left.sum(axis=0)))  # of those taken, -1 is left
        chosen.append(row)
        for known, factor, length in zip(left, factors, lengths, strict=True):
            if known[row] <= LEAST:
                continue
            apart = (near - near[row]) / length
            covariance = np.exp(-0.5 * np.einsum("ij,ij->i", apart, apart))
            factor[number] = (covariance - factor[:number, row] @ factor[:number]) / np.sqrt(known[row])
            known -= factor[number] ** 2
        np.maximum(left, 0.0, out=left)
        left[:, chosen] = -1.0
    found: IntArray = np.sort(pool[chosen])
    return found
