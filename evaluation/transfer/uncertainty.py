"""A fitness, a difference or a ratio with its uncertainty over trials.

All controllers and systems meet the same trials, so that figures can be subtracted and divided trial by trial.
Intervals are Student's, their degrees of freedom those of Satterthwaite (1946). Figures that are no means, such as the
lowest over several models, become sums over trials by the jackknife.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.special import stdtrit

from sysid_evo.errors import InvalidArgument
from sysid_evo.evolution.aggregates import Aggregate, mean
from sysid_evo.types import Array

ENDS = (0.05, 0.95)
"""Quantiles of the draws between which a 90 % interval lies."""


@dataclass(frozen=True)
class Estimate:
    """A fitness, or a difference of two, its standard error and 90 % interval (nan for one trial, and if not known)."""

    value: float
    standard_error: float
    low: float = math.nan
    high: float = math.nan

    @classmethod
    def of(cls, draws: Array | None) -> Estimate | None:
        """Take the value and the spread of the draws behind it, (1 + draws,)."""
        if draws is None:
            return None
        low, high = np.quantile(draws[1:], ENDS)
        return cls(float(draws[0]), float(draws[1:].std()), float(low), float(high))


SHARE = 0.9
"""Of repetitions with other trials, how many give an interval that holds the truth."""


@dataclass(frozen=True)
class PairedEstimate:
    """A figure over trials, of one controller or of several that are compared.

    ``trials`` holds, for each controller, what each of its E trials adds to the figure (E,), about zero. ``sizes`` are
    the numbers of trials that went in. Figures can be subtracted and divided: their trials are paired.
    """

    value: float
    trials: Mapping[str, Array] = field(repr=False)
    sizes: frozenset[int]

    @classmethod
    def of(cls, controller: str, fitness: Array, rule: Aggregate = mean) -> PairedEstimate:
        """Return what ``rule`` says of ``controller``, by default the mean over models.

        ``fitness`` (models, E) is that in every trial. Raises `InvalidArgument` for another shape.
        """
        fitness = np.asarray(fitness, dtype=np.float64)
        if fitness.ndim != 2 or 0 in fitness.shape:
            raise InvalidArgument(f"fitness: expected (models, trials), got shape {fitness.shape}")
        trials = fitness.shape[1]
        adds = np.full(trials, np.nan)
        if trials > 1:
            kept = np.arange(trials)[None, :] + np.arange(1, trials)[:, None]
            without = rule(fitness[:, kept.T % trials])
            adds = np.sqrt((trials - 1) / trials) * (without.mean() - without)
        return cls(float(rule(fitness[:, None])[0]), {controller: adds}, frozenset({trials}))

    def __sub__(self, other: PairedEstimate) -> PairedEstimate:
        return _sum(self.value - other.value, ((1.0, self), (-1.0, other)))

    def over(self, other: PairedEstimate) -> PairedEstimate:
        """Return this figure as a share of ``other``; its spread is that of small differences (the delta method)."""
        share = self.value / other.value
        return _sum(share, ((1.0 / other.value, self), (-share / other.value, other)))

    @cached_property
    def _parts(self) -> tuple[tuple[float, float], ...]:
        """Independent parts of the variance: how large each is, and its degrees of freedom."""
        of_trial = np.zeros(max(self.sizes))
        for adds in self.trials.values():
            of_trial[: len(adds)] += adds
        found = []
        begin = 0
        for end in sorted(self.sizes):
            found.append((float((of_trial[begin:end] ** 2).sum()), max(1.0, end - begin - 1.0)))
            begin = end
        return tuple(found)

    @property
    def standard_error(self) -> float:
        """Over other trials; nan for a single trial."""
        return float(np.sqrt(sum(size for size, _ in self._parts)))

    @property
    def degrees(self) -> float:
        """Degrees of freedom of the standard error."""
        below = sum(size**2 / degrees for size, degrees in self._parts)
        return float(self.standard_error**4 / below) if below > 0.0 else np.inf

    def interval(self, share: float = SHARE) -> tuple[float, float]:
        """Return where the figure lies in ``share`` of the cases; nan for a single trial."""
        error = self.standard_error
        reach = 0.0 if error == 0.0 else float(stdtrit(self.degrees, 0.5 + share / 2.0)) * error
        return self.value - reach, self.value + reach


def _sum(value: float, parts: Sequence[tuple[float, PairedEstimate]]) -> PairedEstimate:
    """Return the weighted sum of figures: what one controller adds to several of them adds up, trial by trial."""
    trials: dict[str, Array] = {}
    for weight, figure in parts:
        for controller, adds in figure.trials.items():
            if controller not in trials:
                trials[controller] = weight * adds
                continue
            longest = max(len(adds), len(trials[controller]))
            padded = [np.pad(a, (0, longest - len(a))) for a in (trials[controller], weight * adds)]
            trials[controller] = padded[0] + padded[1]
    return PairedEstimate(value, trials, frozenset().union(*(figure.sizes for _, figure in parts)))
