"""How near a model is to the noise one step ahead, and whether its form or the noise is what limits it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from evaluation.advice.evidence import Evidence
from evaluation.advice.explaining import explained, lagged, standardised, with_products
from evaluation.advice.remark import Remark
from evaluation.labels import percent
from sysid_evo.arrays import Array, IntArray

LITTLE = 1.25
"""A one-step error within this many times the noise cannot be lowered by a quarter: differences between families that
people act on are larger."""
FORM = 0.2
"""Share of what a model leaves that a plain regression on the model's own inputs explains, from which on its form
limits it: a tenth of the error."""
NEIGHBOURS, APART = 4, 20
"""A pair is a step and the nearest of so many that is more than so many steps away: noise that lasts is in both."""
FEWEST, MOST_PAIRS = 250, 4000


@dataclass(frozen=True)
class Noise:
    """The one-step error N, the ``floor`` that noise sets it, and the share that a plain regression still explains."""

    n: float
    floor: float
    explained: float


def noise_floor(evidence: Evidence) -> Remark | None:
    """Return that little is left to gain one step ahead, or that the form of the model is what limits it."""
    found = estimate_noise(evidence)
    if found is None:
        return None
    figures = {"n": found.n, "noise": found.floor, "explained": found.explained}
    if found.explained >= FORM:
        return Remark(
            "form",
            f"The form of {evidence.name} limits it: a plain regression on the same inputs explains "
            f"{percent(found.explained)} of what it leaves one step ahead. Try a family that is richer, or one with "
            "more of the physics.",
            1.0 - np.sqrt(1.0 - found.explained),
            figures,
        )
    if found.n <= LITTLE * found.floor:
        return Remark(
            "noise",
            f"One step ahead the error of {evidence.name}, N {found.n:.3f}, is {found.n / found.floor:.2f} times the "
            f"noise, {found.floor:.3f}: little is left to gain there with these inputs.",
            0.05,
            figures,
        )
    return None


def estimate_noise(evidence: Evidence) -> Noise | None:
    """Compare what is left at the nearest inputs; None with too few steps.

    Two steps from nearly the same inputs differ by their noise alone: half the mean squared difference of what the
    model leaves at such pairs is the variance of the noise (the model takes out what changes between them), the idea of
    Rice (1984) and of the gamma test. What counts as noise is all that the model's inputs do not determine.
    """
    steps, system = evidence.steps, evidence.system
    rows = steps.scored
    state_lags, control_lags = evidence.model.lags
    states = system.regressors(np.nan_to_num(steps.states))
    states[~np.isfinite(steps.states).all(axis=1)] = np.nan
    now = np.concatenate([states[rows], steps.controls[rows]], axis=1)
    earlier = np.concatenate(
        [lagged(states, range(1, state_lags + 1), rows), lagged(steps.controls, range(1, control_lags + 1), rows)],
        axis=1,
    )
    known = np.isfinite(earlier).all(axis=1)
    if known.sum() < FEWEST:
        return None
    left = steps.errors[rows][known] / evidence.std
    now, earlier, places = now[known], earlier[known], np.flatnonzero(rows)[known]
    some = np.linspace(0, len(left) - 1, min(len(left), MOST_PAIRS)).round().astype(np.int64)
    pairs = _nearest(standardised(np.concatenate([now, earlier], axis=1))[some], places[some])
    floor = np.sqrt(0.5 * np.mean((left[some] - left[some][pairs]) ** 2, axis=0))
    features = np.concatenate([with_products(now), earlier], axis=1)
    return Noise(float(np.sqrt(np.mean(left**2, axis=0)).mean()), float(floor.mean()), explained(features, left))


def _nearest(points: Array, places: IntArray) -> IntArray:
    """Return for each point the nearest that is more than `APART` steps away in time."""
    from scipy.spatial import cKDTree

    count = min(len(points), NEIGHBOURS + 2 * APART + 1)
    near = np.asarray(cKDTree(points).query(points, k=count)[1], dtype=np.int64)
    apart = np.abs(places[near] - places[:, None]) > APART
    return np.asarray(near[np.arange(len(near)), apart.argmax(axis=1)])
