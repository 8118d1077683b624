"""A correction learned by free runs: damped least squares with derivatives along the runs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from sysid_evo.adaptation.pieces import FARTHEST, Pieces, free_runs, off
from sysid_evo.adaptation.sensitivities import sensitivities
from sysid_evo.adaptation.terms import Terms
from sysid_evo.arrays import Array
from sysid_evo.dynamics.stepping import Dynamics

ROUNDS = 2
"""Linearisations for each ridge; the first starts where that of the stronger one ended."""
SHORTENINGS = (1.0, 0.3, 0.1)
TOLERATED = 1.5
"""Standard deviations beyond which an error counts in proportion and no longer in square (Huber)."""


def corrections(
    model: Dynamics, terms: Terms, pieces: Pieces, ridges: Sequence[float], seconds: float
) -> Iterator[Array]:
    """Yield the coefficients (size, nx) for each of ``ridges``, which begin with the strongest.

    They minimise seconds * mean(error^2) + ridge * sum(weight * coefficients^2), with the weight of the terms, errors
    in standard deviations over windows, steps and states: a ridge of 3 counts as much as three seconds of such data.
    Large errors count less (Huber's weights), since a run that diverges says little of what would prevent it.
    """
    found = np.zeros(terms.shape)
    for ridge in ridges:
        for _ in range(ROUNDS):
            found, moved = _improved(model, terms, pieces, found, ridge * terms.weight, seconds)
            if not moved:
                break
        yield found


def _improved(
    model: Dynamics, terms: Terms, pieces: Pieces, start: Array, ridge: Array, seconds: float
) -> tuple[Array, bool]:
    """Return better coefficients by one linearisation, and whether there are any."""
    size = start.size
    runs, derivatives = sensitivities(model, terms, start, pieces)
    here = off(terms, runs[None], pieces).ravel()
    slopes = np.where(np.abs(here) < FARTHEST, (derivatives / pieces.scale).reshape(size, -1), 0.0)
    weights = _weights(here)
    share = seconds / here.size
    normal = share * (slopes * weights) @ slopes.T + np.diag(ridge.ravel())
    step = np.linalg.solve(normal, -share * slopes @ (weights * here) - (ridge * start).ravel()).reshape(start.shape)
    if not np.isfinite(step).all():
        return start, False
    candidates = np.stack([start, *(start + length * step for length in SHORTENINGS)])
    reached = off(terms, free_runs(model, terms, candidates, pieces), pieces)
    costs = [_cost(one, found, ridge, seconds) for one, found in zip(reached, candidates, strict=True)]
    best = int(np.argmin(costs))
    return candidates[best], costs[best] < (1.0 - 1e-3) * costs[0]


def _weights(errors: Array) -> Array:
    return np.minimum(1.0, TOLERATED / np.maximum(np.abs(errors), 1e-12))


def _cost(errors: Array, coefficients: Array, ridge: Array, seconds: float) -> float:
    size = np.abs(errors)
    huber = np.where(size <= TOLERATED, size**2, TOLERATED * (2.0 * size - TOLERATED))
    return float(seconds * huber.mean() + np.sum(ridge * coefficients**2))
