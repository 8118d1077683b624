"""How far models are believed, and what they say together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from evaluation.forecast.rule import RULE, Rule
from evaluation.prediction import ModelPrediction
from sysid_evo.arrays import Array, BoolArray

HORIZON = 20
"""Steps after which the prediction error counts, where it was measured there."""
LEAST_ERROR = 0.01
"""Errors below this, in standard deviations of the data, are told apart no more."""


def error_of(found: ModelPrediction | None) -> float | None:
    """Return N of a model on held-out data, None where it is not known."""
    if found is None or not found.at:
        return None
    return (found.score(HORIZON) or found.at[-1]).n


def credibilities(errors: Sequence[float | None], own: BoolArray, *, rule: Rule = RULE) -> Array:
    """Return the weight of each model, (M,), that add up to 1.

    ``errors`` are those of `error_of`; a model whose error is not known counts as much as the best one. ``own`` (M,)
    says which are of a family that the controller was evolved in.
    """
    known = [max(error, LEAST_ERROR) for error in errors if error is not None and np.isfinite(error)]
    best = min(known, default=1.0)
    weights = np.array([_weight(best, error, rule.power) for error in errors])
    weights = np.where(own, rule.own, 1.0) * weights
    total = float(weights.sum())
    return weights / total if total > 0.0 else np.full(len(weights), 1.0 / max(1, len(weights)))


def weighted_median(values: Array, weights: Array) -> Array:
    """Return the median (...) of ``values`` (M, ...) with these weights (M,), between two of them as they weigh.

    Each value stands at the middle of its weight, and what lies between two is interpolated: of equal weights it is
    the usual median.
    """
    order = np.argsort(values, axis=0, kind="stable")
    ranked, weight = np.take_along_axis(values, order, axis=0), weights[order]
    middle = np.cumsum(weight, axis=0) - 0.5 * weight
    flat, at = ranked.reshape(len(values), -1), middle.reshape(len(values), -1)
    found = [np.interp(0.5 * weights.sum(), at[:, i], flat[:, i]) for i in range(flat.shape[1])]
    return np.array(found).reshape(values.shape[1:])


def _weight(best: float, error: float | None, power: float) -> float:
    """Return the weight of a model beside that of the best, which is 1."""
    if error is None:
        return 1.0
    return float((best / max(error, LEAST_ERROR)) ** power) if np.isfinite(error) else 0.0
