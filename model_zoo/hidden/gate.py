"""A short record may not tell the weights of a network: there it must be better than a linear state space."""

from __future__ import annotations

from typing import Any

import numpy as np

from model_zoo.hidden.family import StateSpaceModel
from model_zoo.linear_state_space import STEPS, LinearStateSpace
from sysid_evo.cross_validation import time_blocks
from sysid_evo.data import Dataset
from sysid_evo.free_run import judging_windows, simulation_error

LINEAR = "linear_state_space"
FEW, FOLDS, BETTER = 600, 3, 0.9
"""A record of fewer samples is gated: on so many folds networks must be better by this factor."""


def linear_instead(
    networks: StateSpaceModel, dataset: Dataset, rng: np.random.Generator, **settings: Any
) -> StateSpaceModel | None:
    """Return a linear state space with these ``settings``, fitted to ``dataset``, if it is short and that is safer.

    It is unless ``networks``, not fitted, are a tenth better in free runs on held-out blocks of time.
    """
    if dataset.n_steps >= FEW:
        return None
    seed = int(rng.integers(2**63))
    plain = LinearStateSpace(folds=1, **settings)
    errors = [0.0, 0.0]
    for learned, held in (time_blocks(dataset, fold, FOLDS) for fold in range(FOLDS)):
        for i, model in enumerate((networks, plain)):
            model.fit(learned, rng=np.random.default_rng(seed))
            windows = judging_windows(held, model.n_lags, fewest=STEPS)
            errors[i] += float(np.nan_to_num(simulation_error(model, windows), nan=np.inf))
    if errors[0] <= BETTER * errors[1]:
        return None
    return plain.fit(dataset, rng=np.random.default_rng(seed))
