"""Aggregates: how the fitnesses on several models and in several trials become one (paper, section 4.5)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np

from sysid_evo.arrays import Array, IntArray
from sysid_evo.errors import InvalidArgument
from sysid_evo.registry import make_aggregate, register_aggregate


class Aggregate(ABC):
    """One fitness for each candidate, from all that it scored.

    The result is in the unit of the fitness, so that it can be compared with what is achieved
    elsewhere: where a candidate scores the same everywhere, that is its fitness. What evolution climbs
    may differ from it, see `in_population` and `models`; what a candidate claims may not.

    One that gives ``mean_of_one`` model makes of it the mean over its trials, to the last bit: what is evolved in one
    model is then the same under all such rules, and is computed once.
    """

    mean_of_one: ClassVar[bool] = False

    @abstractmethod
    def __call__(self, fitness: Array) -> Array:
        """Return the fitness (candidates,) from that on each model in each trial, (models, candidates, trials)."""

    def in_population(self, fitness: Array) -> Array:
        """Return what evolution climbs, (candidates,); here candidates may be compared with each other."""
        return self(fitness)

    def models(self, count: int, generation: int) -> IntArray:
        """Return which of ``count`` models are run in ``generation``, in rising order; by default all."""
        return np.arange(count)

    def at_most(self, fitness: Array, count: int) -> Array:  # nothing is known by default
        """Return the most (candidates,) that `in_population` can become once all of ``count`` models are run.

        ``fitness`` (models, candidates, trials) is that on those that were run already, one or more. Where nothing
        can be said it is infinite, by default always. Who says more spares dear models those candidates that
        cannot become good enough; `in_population` then judges every candidate for itself.
        """
        return np.full(fitness.shape[1], np.inf)


@register_aggregate("min")
class Lowest(Aggregate):
    """The lowest of the models' means over the trials: the paper's rule."""

    mean_of_one = True

    def __call__(self, fitness: Array) -> Array:
        return np.min(fitness.mean(axis=2), axis=0)

    def at_most(self, fitness: Array, count: int) -> Array:  # however many follow
        return self(fitness)


@register_aggregate("mean")
class Mean(Aggregate):
    """The mean of the models' means over the trials."""

    mean_of_one = True

    def __call__(self, fitness: Array) -> Array:
        return np.mean(fitness.mean(axis=2), axis=0)


@register_aggregate("median")
class Median(Aggregate):
    """The median of the models' means over the trials."""

    mean_of_one = True

    def __call__(self, fitness: Array) -> Array:
        return np.median(fitness.mean(axis=2), axis=0)

    def at_most(self, fitness: Array, count: int) -> Array:
        return highest_median(fitness.mean(axis=2), count)


@register_aggregate("cvar")
class ConditionalValueAtRisk(Aggregate):
    """The mean of the worst ``share`` of a candidate's outcomes, those of all models and trials together.

    With ``share`` 1 it is the mean; towards 0 it becomes the single worst trial. One outcome may count in part,
    so that the worst 25 % of ten outcomes are two and a half (Rockafellar and Uryasev 2000).
    """

    def __init__(self, *, share: float = 0.3) -> None:
        if not 0.0 < share <= 1.0:
            raise InvalidArgument(f"cvar: expected share above 0 and at most 1, got {share}")
        self.share = share

    def __call__(self, fitness: Array) -> Array:
        models, candidates, trials = fitness.shape
        worst_first = np.sort(fitness.transpose(1, 0, 2).reshape(candidates, models * trials), axis=1)
        counted = max(1.0, self.share * models * trials)
        weights = np.clip(counted - np.arange(models * trials), 0.0, 1.0)
        return worst_first @ weights / counted


@register_aggregate("lower_confidence")
class LowerConfidence(Aggregate):
    """The lowest over the models of the mean less ``weight`` standard errors, both over the trials.

    A candidate that was lucky in a few trials counts less than one that is steadily as good. One trial has no
    spread, so that its mean counts as it is.
    """

    def __init__(self, *, weight: float = 1.0) -> None:
        if not 0.0 <= weight < np.inf:
            raise InvalidArgument(f"lower_confidence: expected weight >= 0, got {weight}")
        self.weight = weight

    def __call__(self, fitness: Array) -> Array:
        trials = fitness.shape[2]
        error = fitness.std(axis=2, ddof=min(1, trials - 1)) / np.sqrt(trials)
        return np.min(fitness.mean(axis=2) - self.weight * error, axis=0)

    def at_most(self, fitness: Array, count: int) -> Array:  # however many follow
        return self(fitness)


@register_aggregate("credible")
class Credible(Aggregate):
    """The lowest of the models' means, but never below ``share`` of the candidate's median over the models.

    A model that denies what most believe can thus forbid nothing: it takes away no more than the rest of the
    share, and the candidate goes on climbing by its median. (To leave such a model out altogether would reward
    a candidate for doing worse on it.) A median below zero is lowered by as much as one above zero would be.
    """

    def __init__(self, *, share: float = 0.7) -> None:
        if not 0.0 <= share <= 1.0:
            raise InvalidArgument(f"credible: expected share from 0 to 1, got {share}")
        self.share = share

    def __call__(self, fitness: Array) -> Array:
        means = fitness.mean(axis=2)
        return np.maximum(means.min(axis=0), self._floor(np.median(means, axis=0)))

    def at_most(self, fitness: Array, count: int) -> Array:
        means = fitness.mean(axis=2)
        median = highest_median(means, count)
        known = np.isfinite(median)
        floor = np.where(known, self._floor(np.where(known, median, 0.0)), np.inf)
        return np.maximum(means.min(axis=0), floor)

    def _floor(self, median: Array) -> Array:
        return median - (1.0 - self.share) * np.abs(median)


@register_aggregate("rank_mean")
class RankMean(Aggregate):
    """The mean over the models of the rank that a candidate has on each of them.

    A model on which fitness spreads more, or is higher, thus counts no more than another. In a population the
    mean rank is turned back into fitness: it is what stands at that rank, the mean of the models. Alone a
    candidate has no rank, and what it claims is the mean of the models' means.
    """

    def __call__(self, fitness: Array) -> Array:
        return np.mean(fitness.mean(axis=2), axis=0)

    def in_population(self, fitness: Array) -> Array:
        means = fitness.mean(axis=2)
        in_order = np.sort(means, axis=1)
        ranks = [
            (np.searchsorted(row, mine, "left") + np.searchsorted(row, mine, "right") - 1) / 2.0
            for row, mine in zip(in_order, means, strict=True)
        ]
        return np.interp(np.mean(ranks, axis=0), np.arange(means.shape[1]), in_order.mean(axis=0))


@register_aggregate("random_subset")
class RandomSubset(Aggregate):
    """Only ``size`` of the models are run in a generation, drawn anew by (``seed``, generation).

    It costs less than to run them all, and no model can be exploited for long. ``rule`` is the aggregate of
    those that were run. What a candidate claims is by the ``rule`` on all models that it is given.
    """

    def __init__(self, *, size: int = 2, rule: str = "min", seed: int = 0) -> None:
        if size < 1 or seed < 0:
            raise InvalidArgument(f"random_subset: expected size >= 1 and seed >= 0, got {size} and {seed}")
        self.size, self.seed = size, seed
        self._rule = make_aggregate(rule)

    def __call__(self, fitness: Array) -> Array:
        return self._rule(fitness)

    def in_population(self, fitness: Array) -> Array:
        return self._rule.in_population(fitness)

    def models(self, count: int, generation: int) -> IntArray:
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(generation,)))
        return np.sort(rng.permutation(count)[: self.size])

    def at_most(self, fitness: Array, count: int) -> Array:
        return self._rule.at_most(fitness, count)


def highest_median(means: Array, count: int) -> Array:
    """Return the most (candidates,) that the median over ``count`` models can be; ``means`` (models, candidates)."""
    others = np.full((count - len(means), means.shape[1]), np.inf)
    return np.median(np.concatenate([means, others]), axis=0)
