"""The normal distribution that CMA-ES adapts, with less to compute in every generation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from cma.sampler import GaussFullSampler

from sysid_evo.arrays import Array

LAZIER = 10.0
"""How many times longer the axes are kept than the library keeps them."""


class GaussianSampler(GaussFullSampler):  # type: ignore[misc]  # the library has no types
    """The sampler of ``cma`` that learns from all candidates at once and finds its axes less often.

    The axes B D of C = B D^2 B^T are found anew as soon as C may have changed by 1 / n since, in generations
    1 / (n (c_1 + c_mu)), instead of by a tenth of that as in the tutorial (Hansen 2016, appendix B.2): in
    a hundred dimensions that was the most of the time, and which candidates come differs little.
    """

    def update(self, vectors: Sequence[Array], weights: Sequence[float], c1_times_delta_hsigma: float = 0.0) -> None:
        """Learn from ``vectors`` (P, n) by ``weights`` (P,); those of negative weight count by their length in C."""
        rows, shares = np.asarray(vectors), np.array(weights)
        self.C *= 1.0 + c1_times_delta_hsigma - shares.sum()
        away = shares < 0.0
        if away.any():
            lengths = np.linalg.norm(rows[away] @ self.B / self.D, axis=1)
            shares[away] *= rows.shape[1] / (lengths + 1e-9) ** 2
        self.C += (shares[:, None] * rows).T @ rows
        self.count_tell += 1
