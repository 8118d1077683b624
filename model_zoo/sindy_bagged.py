"""SINDy on bootstrapped blocks of time: the mean of the sparse fits that simulate best."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from model_zoo.sparse.flow import ContinuousSparse
from sysid_evo import Dataset, register_model
from sysid_evo.free_run import judging_windows, simulation_error
from sysid_evo.hyperparameters import Limit, above, at_least
from sysid_evo.progress import Counter

BLOCK_STEPS = 40
STRIDE = 12


@register_model("sindy_bagged")
class SindyBagged(ContinuousSparse):
    """dx/dt = Theta(x, u) Xi + w(x) as `Sindy`, Xi the mean of the best of ``bags`` fits (after Fasel et al. 2022).

    Each fit sees as many blocks of 40 consecutive steps as there are, drawn with replacement; those
    ``kept`` (a share) are the ones with the lowest simulation error over one second in all data. The
    mean, not the median of E-SINDy: terms that stand in for each other must keep their sum. Degree,
    threshold and lags are chosen as by `Sindy`, without bags.
    """

    presets: ClassVar[dict[str, dict[str, Any]]] = {
        "quick": {"degree": 2, "control_lags": 0, "bags": 8},
        "paper": {"bags": 50},
    }
    limits: ClassVar[dict[str, Limit]] = {"bags": at_least(1), "kept": above(0, at_most=1)}

    bags: int = 20
    kept: float = 0.35

    def learn(
        self, dataset: Dataset, degree: int, threshold: float, rng: np.random.Generator, counter: Counter
    ) -> None:
        data = self.regression(dataset, self.lags)
        blocks = np.array_split(np.arange(len(data.regressors)), max(1, len(data.regressors) // BLOCK_STEPS))
        windows = judging_windows(dataset, self.n_lags, stride=STRIDE)
        fits, errors = [], []
        for _ in range(self.bags):
            counter.advance(0)
            rows = np.concatenate([blocks[block] for block in rng.integers(0, len(blocks), len(blocks))])
            library = self.library_of(data[rows], self.lags, degree)
            coefficients = self.solved(library, threshold)
            self.adopt(data, coefficients, library.exponents)
            fits.append(coefficients)
            errors.append(simulation_error(self, windows))
        best = np.argsort(errors, kind="stable")[: max(1, round(self.kept * self.bags))]
        kept = np.stack([fits[index] for index in best])
        self.adopt(data, kept.mean(axis=0), library.exponents)
        used = np.flatnonzero(np.any(kept.mean(axis=0) != 0, axis=1))
        self.bags_ = kept[:, used if len(used) else [0]]
