"""How often intervals hold the truth."""

from __future__ import annotations

import numpy as np

from model_zoo.validation.spread import SHARE
from sysid_evo.arrays import Array


def coverage(samples: Array, truth: Array, *, share: float = SHARE) -> Array:
    """Return how much of ``truth`` (N, nx) lies in the central ``share`` of ``samples`` (S, N, nx), (nx,)."""
    low, high = np.quantile(samples, [0.5 - share / 2, 0.5 + share / 2], axis=0, method="weibull")
    return ((truth >= low) & (truth <= high)).mean(axis=0)
