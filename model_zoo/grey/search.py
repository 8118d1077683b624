"""Where the least squares of a grey box begin, which of their ends is taken, and how sure it is."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from model_zoo.grey.estimation import Estimate, LeastSquares
from model_zoo.grey.parameter import Box, Parameter
from model_zoo.grey.uncertainty import Sureness, sureness
from sysid_evo.arrays import Array

SCREENED = 48
"""Places of the cube that are looked at, the best of which are starts."""
FIRST_EVALUATIONS, LAST_EVALUATIONS = 40, 100
KEPT = 2
"""Starts of the last fit: the best ends of the first one."""


def starts_of(first: LeastSquares, count: int, rng: np.random.Generator) -> list[Array]:
    """Return the guess and the best of many random places of the cube, ``count`` in all."""
    box = first.structure.box
    guess = box.places(np.array([parameter.guess for parameter in first.structure.parameters]))
    drawn = rng.uniform(size=(SCREENED, len(guess)))
    costs = np.concatenate([first.cost(part) for part in np.array_split(drawn, SCREENED // 8)])
    return [guess, *drawn[np.argsort(costs, kind="stable")[: count - 1]]]


def best_of(last: LeastSquares, begun: Sequence[Array]) -> Estimate:
    """Return the best least squares from the best of these ends of the first fit."""
    costs = [float(last.cost(place[None])[0]) for place in begun]
    found: list[Estimate] = []
    for i in np.argsort(costs, kind="stable"):
        if all(np.abs(begun[i] - one.places).max() > 1e-3 for one in found) and len(found) < KEPT:
            found.append(last.solve(begun[i], evaluations=LAST_EVALUATIONS))
    return min(found, key=lambda one: one.cost)


def sureness_of(problem: LeastSquares, best: Estimate) -> Sureness:
    """Return how sure the parameters are at the end of a fit."""
    known = known_variances(problem.structure.parameters, best.places)
    return sureness(best.errors, best.jacobian, best.by_hidden, problem.segments.order, known=known)


def known_variances(parameters: Sequence[Parameter], places: Array) -> Array:
    """Return the variance (n,) of each place in the cube without data: that of its prior, or of its bounds alone."""
    slopes = Box.of(parameters).slopes(places)
    spreads = np.array([math.inf if p.spread is None else p.spread for p in parameters]) / slopes
    return np.minimum(spreads**2, 1.0 / 12.0)
