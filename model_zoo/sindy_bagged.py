"""SINDy on bootstrapped blocks of time: the median of many sparse fits."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from model_zoo.sparse_flow import ContinuousSparse
from model_zoo.sparse_regression import Regression, sparse_coefficients
from sysid_evo.arrays import Array, IntArray
from sysid_evo.errors import InvalidArgument
from sysid_evo.registry import register_model

BLOCK_STEPS = 40


@register_model("sindy_bagged")
class SindyBagged(ContinuousSparse):
    """dx/dt = Theta(x, u) Xi + w(x) as `Sindy`, Xi the median over ``bags`` fits (Fasel et al. 2022, E-SINDy).

    Each fit sees as many blocks of 40 consecutive steps as there are, drawn with replacement. A
    term stays in an equation if at least ``inclusion`` of the fits keep it there.
    """

    search_folds = 1
    presets: ClassVar[dict[str, dict[str, Any]]] = {"quick": {"degree": 2, "control_lags": 0, "bags": 5}}

    def __init__(
        self,
        *,
        bags: int = 10,
        inclusion: float = 0.6,
        degree: int | None = None,
        threshold: float | None = None,
        ridge: float = 1e-3,
        state_lags: int | None = 0,
        control_lags: int | None = None,
        rest_hold: bool = False,
    ) -> None:
        self.bags = bags
        self.inclusion = inclusion
        self.degree = degree
        self.threshold = threshold
        self.ridge = ridge
        self.state_lags = state_lags
        self.control_lags = control_lags
        self.rest_hold = rest_hold

    def coefficients(
        self, data: Regression, degree: int, threshold: float, rng: np.random.Generator
    ) -> tuple[Array, IntArray]:
        if self.bags < 1 or not 0.0 <= self.inclusion <= 1.0:
            raise InvalidArgument(
                f"sindy_bagged: expected bags >= 1 and 0 <= inclusion <= 1, got {self.bags}, {self.inclusion}"
            )
        blocks = np.array_split(np.arange(len(data.regressors)), max(1, len(data.regressors) // BLOCK_STEPS))
        fits = []
        for _ in range(self.bags):
            drawn = rng.integers(0, len(blocks), len(blocks))
            rows = np.concatenate([blocks[block] for block in drawn])
            fits.append(sparse_coefficients(data[rows], degree, threshold, self.ridge))
        every = np.stack([coefficients for coefficients, _ in fits])
        kept = (every != 0).mean(axis=0) >= self.inclusion
        return np.where(kept, np.median(every, axis=0), 0.0), fits[0][1]
