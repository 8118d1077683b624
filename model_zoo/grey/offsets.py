"""Parameters that differ from recording to recording: offsets, shrunk to the common value (random effects)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from model_zoo.grey.estimation import Estimate, LeastSquares
from model_zoo.grey.uncertainty import Sureness
from sysid_evo.arrays import Array

ROUNDS = 6
FIRST_SPREAD = 0.05
"""Standard deviation of the offsets in the cube that is assumed at first."""
EVALUATIONS = 12
LEAST = 1e-4
"""Of the width of the bounds: a standard deviation that is none."""


@dataclass(frozen=True)
class Offsets:
    """The estimate with offsets, their standard deviations ``spreads`` (k,) from group to group, in the cube."""

    estimate: Estimate
    spreads: Array


def with_offsets(problem: LeastSquares, best: Estimate, sure: Sureness, varied: Sequence[int]) -> Offsets:
    """Return the least squares in which some parameters have an offset in each group, normal around nothing.

    How far they spread is found with them: the spread whose square is the mean of offset^2 + the variance of what is
    left unknown of it, again and again (expectation, maximisation; Laird and Ware 1982). Few data of a group, or none
    that depend on the parameter, leave its offset near zero. Errors that hang together count as ``sure.inflation``
    times fewer.
    """
    spreads, found = np.full(len(varied), FIRST_SPREAD), best
    for _ in range(ROUNDS):
        varying = replace(problem, varied=tuple(varied), spreads=spreads, noise=sure.noise, inflation=sure.inflation)
        found = varying.solve(found.places, evaluations=EVALUATIONS, hidden=found.hidden)
        unknown = _unknown(varying, found)
        spreads = np.maximum(np.sqrt(np.mean(found.offsets**2 + unknown, axis=0)), LEAST)
    return Offsets(found, spreads)


def _unknown(problem: LeastSquares, found: Estimate) -> Array:
    """Return the variance (G, k) of each offset that the data of its group leave, each by itself."""
    square = problem.noise**2 * problem.inflation
    by = found.jacobian[..., list(problem.varied)]
    each = np.sum(by**2, axis=1)  # (W, k)
    information = np.zeros((problem.n_groups, by.shape[2]))
    np.add.at(information, problem.segments.group, each / square)
    return np.asarray(1.0 / (information + 1.0 / problem.spreads**2))
