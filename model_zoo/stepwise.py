"""Single steps with lags, from where the body moves."""

from __future__ import annotations

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.data import Dataset
from sysid_evo.errors import InvalidData


def lagged_steps(dataset: Dataset, lags: tuple[int, int]) -> tuple[Array, Array, Array]:
    """Return carry (N, n), control (N, nu) and next state (N, nx) of every step that is no standstill.

    Steps of a data set that stands still throughout are all returned. Raises `InvalidData`.
    """
    history = max(lags)
    windows = dataset.windows(1, history=history, moving=True)
    if not len(windows):
        windows = dataset.windows(1, history=history)
    if not len(windows):
        raise InvalidData(f"data set: no episode is longer than {history} steps, the history asked for")
    parts = [windows.past_states[:, -1 - lag] for lag in range(lags[0] + 1)]
    parts += [windows.past_controls[:, -1 - lag] for lag in range(lags[1])]
    return np.concatenate(parts, axis=1), windows.controls[:, 0], windows.states[:, 0]
