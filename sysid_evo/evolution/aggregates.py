"""Aggregates: how the fitnesses on several models and in several trials become one (paper, section 4.5)."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.registry import register_aggregate


class Aggregate(ABC):
    """One fitness for each candidate, from all that it scored.

    The result is in the unit of the fitness, so that it can be compared with what is achieved
    elsewhere: where a candidate scores the same everywhere, that is its fitness.
    """

    @abstractmethod
    def __call__(self, fitness: Array) -> Array:
        """Return the fitness (candidates,) from that on each model in each trial, (models, candidates, trials)."""


@register_aggregate("min")
class Lowest(Aggregate):
    """The lowest of the models' means over the trials: the paper's rule."""

    def __call__(self, fitness: Array) -> Array:
        return np.min(fitness.mean(axis=2), axis=0)


@register_aggregate("mean")
class Mean(Aggregate):
    """The mean of the models' means over the trials."""

    def __call__(self, fitness: Array) -> Array:
        return np.mean(fitness.mean(axis=2), axis=0)


@register_aggregate("median")
class Median(Aggregate):
    """The median of the models' means over the trials."""

    def __call__(self, fitness: Array) -> Array:
        return np.median(fitness.mean(axis=2), axis=0)
