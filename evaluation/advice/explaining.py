"""How much of something a plain regression explains, on stretches of time that it has not seen."""

from __future__ import annotations

import numpy as np

from sysid_evo.arrays import Array, BoolArray

FOLDS, STRETCH = 5, 50
"""Every fifth stretch of so many rows is held out in turn."""
RIDGES = (1.0, 30.0, 1000.0)


def explained(features: Array, targets: Array) -> float:
    """Return the share of the variance of ``targets`` (N, k), each scaled alike, that ``features`` (N, m) explain.

    Both are in order of time; each stretch is predicted from the others, by ridge regression with the best of three
    ridges. 0 if nothing is explained, or there are fewer rows than would show it.
    """
    if len(targets) < FOLDS * STRETCH:
        return 0.0
    left = unexplained(features, targets)
    return max(0.0, 1.0 - float(np.mean(left)))


def unexplained(features: Array, targets: Array) -> Array:
    """Return the share (k,) of the variance of each column of ``targets`` that is left, with the best ridge."""
    x = standardised(features)
    y = targets - targets.mean(axis=0)
    total = np.mean(y**2, axis=0)
    total = np.where(total > 0.0, total, np.inf)
    fold = (np.arange(len(y)) // STRETCH) % FOLDS
    squares = np.zeros((len(RIDGES), y.shape[1]))
    whole = x.T @ x, x.T @ y
    for number in range(FOLDS):
        held = fold == number
        gram, cross = whole[0] - x[held].T @ x[held], whole[1] - x[held].T @ y[held]
        for place, ridge in enumerate(RIDGES):
            weights = np.linalg.solve(gram + ridge * np.eye(len(gram)), cross)
            squares[place] += ((y[held] - x[held] @ weights) ** 2).sum(axis=0)
    shares = squares / len(y) / total
    return np.asarray(shares[shares.mean(axis=1).argmin()])


def standardised(features: Array) -> Array:
    """Return each column with mean 0 and standard deviation 1; one that is constant becomes 0."""
    std = features.std(axis=0)
    return np.asarray((features - features.mean(axis=0)) / np.where(std > 0.0, std, np.inf))


def with_products(features: Array) -> Array:
    """Return the columns of ``features`` (N, m), standardised, and all products of two of them."""
    x = standardised(features)
    first, second = np.triu_indices(x.shape[1])
    return np.concatenate([x, x[:, first] * x[:, second]], axis=1)


def lagged(values: Array, lags: range, rows: BoolArray) -> Array:
    """Return ``values`` (M, c) at each of ``lags`` before the ``rows`` (M,), side by side; nan where there is none."""
    found = []
    for lag in lags:
        moved = np.full_like(values, np.nan)
        moved[lag:] = values[: len(values) - lag]
        found.append(moved[rows])
    return np.concatenate(found, axis=1) if found else np.empty((int(rows.sum()), 0))
