"""How often a model's intervals hold what was measured."""

from __future__ import annotations

import numpy as np

from evaluation.prediction.cases import MeasuredCases
from evaluation.prediction.scores import Coverage
from sysid_evo.arrays import Array, IntArray
from sysid_evo.dynamics import DynamicsModel

SHARE = 0.9
"""What the intervals are to hold."""
SAMPLES = 100
MOST_WINDOWS = 400
PIECE = 50
"""Windows that are simulated together."""


def interval_coverage(model: DynamicsModel, cases: MeasuredCases) -> tuple[Coverage, ...]:
    """Return the coverage of the central 90 % of 100 samples at every horizon; nothing of a model without noise.

    Of many windows 400 are taken, evenly spread. Only targets that move count. The draws are the same every time.
    """
    if not (model.n_noise or model.n_draws) or not len(cases.windows):
        return ()
    windows = cases.windows
    few = np.unique(np.linspace(0, len(windows) - 1, min(MOST_WINDOWS, len(windows))).astype(np.int64))
    pieces = np.array_split(few, -(-len(few) // PIECE))
    held = np.concatenate([_held(model, cases, rows) for rows in pieces], axis=1)
    found = []
    for place, horizon in enumerate(cases.horizons):
        rows = cases.moving[few, horizon - 1]
        if rows.any():
            found.append(Coverage(horizon, int(rows.sum()), SHARE, held[place][rows].mean(axis=0)))
    return tuple(found)


def _held(model: DynamicsModel, cases: MeasuredCases, rows: IntArray) -> Array:
    """Return whether each target lies inside, (horizons, N, nx), for the windows ``rows``."""
    windows = cases.windows[rows]
    past_states, past_controls = cases.history(model.n_lags)
    drawn = model.simulate(
        past_states[rows],
        past_controls[rows],
        windows.controls,
        samples=SAMPLES,
        rng=np.random.default_rng(int(rows[0])),
    )
    ends = [horizon - 1 for horizon in cases.horizons]
    low, high = np.quantile(drawn[:, :, ends], [0.5 - SHARE / 2, 0.5 + SHARE / 2], axis=0, method="weibull")
    truth = cases.system.near(windows.states[:, ends], 0.5 * (low + high))
    return ((truth >= low) & (truth <= high)).transpose(1, 0, 2).astype(np.float64)
