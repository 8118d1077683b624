"""Figures with intervals over evolution seeds and trials, which hold the truth with as few as three seeds too.

The controllers of S evolution seeds meet the same E trials, so that a figure varies with the seed, with the trial, and
with both together. The variance of its mean over all is that of the trials plus that of the seeds less what the seeds
owe to the trials (Searle, Casella and McCulloch 1992, chapter 4), its degrees of freedom are those of Satterthwaite
(1946), and intervals are Student's. The percentiles of a nested bootstrap cannot leave the range of the seeds: of
three they hold the truth in about two of three cases (``python -m tests.benchmarks.nested``). Figures that are no
means, such as the lowest over several models, become sums over trials by the jackknife.

Three seeds may fall into one of two basins together, and then show nothing of how far seeds differ. The other
controllers of a matrix do: `alike` gives each what is known from the others, as a prior on the variance between its
seeds (Smyth 2004, of genes in place of controllers).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeAlias

import numpy as np
from scipy.special import stdtrit

from sysid_evo.arrays import Array
from sysid_evo.errors import InvalidArgument
from sysid_evo.registry import make_aggregate

SHARE = 0.9
"""Of repetitions with other seeds and trials, how many give an interval that holds the truth."""

PRIOR_DEGREES = 8.0
"""What is known from very many other controllers of how far seeds differ counts as much as this many degrees."""

Rule: TypeAlias = Callable[[Array], Array]
"""How fitness on models (models, candidates, trials) becomes one figure (candidates,)."""


@dataclass(frozen=True)
class Prior:
    """What other controllers tell of one: the ``variance`` between its seeds, worth this many ``degrees``."""

    variance: float
    degrees: float

    def with_own(self, variance: float, degrees: float) -> tuple[float, float]:
        """Return the variance and its degrees with those of the controller's own seeds.

        Own seeds that differ less are believed in part. Those that differ further keep their variance, and what is
        known from others counts the less: it is not of the same kind.
        """
        both = self.degrees + degrees
        if variance <= self.variance:
            return (self.degrees * self.variance + degrees * variance) / both, both
        return variance, degrees + self.degrees * self.variance / variance


@dataclass(frozen=True)
class Nested:
    """A figure over evolution seeds and trials, of one controller or of several that are compared.

    ``seeds`` holds, for each controller, what each of its S seeds adds to the figure (S,), ``trials`` what each of its
    E trials adds in each seed (S, E), both about zero. ``sizes`` are the numbers of trials that went in; ``priors`` say
    what others tell of how far the seeds of a controller differ, see `alike`. Figures can be subtracted, averaged and
    divided: seeds of one controller and trials are paired.
    """

    value: float
    seeds: Mapping[str, Array] = field(repr=False)
    trials: Mapping[str, Array] = field(repr=False)
    sizes: frozenset[int]
    priors: Mapping[str, Prior] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, controller: str, fitness: Array, rule: Rule | None = None) -> Nested:
        """Return the figure of ``controller``, the mean over its seeds of what ``rule`` says of each.

        ``fitness`` (models, S, E) is that of the controller of every seed in every trial; without ``rule``, an
        aggregate, the mean over models. Raises `InvalidArgument` for another shape.
        """
        fitness = np.asarray(fitness, dtype=np.float64)
        if fitness.ndim != 3 or 0 in fitness.shape:
            raise InvalidArgument(f"fitness: expected (models, seeds, trials), got shape {fitness.shape}")
        rule = rule or make_aggregate("mean")
        models, seeds, trials = fitness.shape
        values = rule(fitness)
        adds = np.full((seeds, trials), np.nan)
        if trials > 1:
            kept = np.arange(trials)[None, :] + np.arange(1, trials)[:, None]
            left = fitness[:, :, kept.T % trials].reshape(models, seeds * trials, trials - 1)
            without = rule(left).reshape(seeds, trials)
            adds = np.sqrt((trials - 1) / trials) * (without.mean(axis=1, keepdims=True) - without)
        value = float(values.mean())
        return cls(value, {controller: values - value}, {controller: adds}, frozenset({trials}))

    def __sub__(self, other: Nested) -> Nested:
        return _sum(self.value - other.value, ((1.0, self), (-1.0, other)))

    def over(self, other: Nested) -> Nested:
        """Return this figure as a share of ``other``; its spread is that of small differences (the delta method)."""
        share = self.value / other.value
        return _sum(share, ((1.0 / other.value, self), (-share / other.value, other)))

    @property
    def n_seeds(self) -> int:
        """The smallest number of evolution seeds in it."""
        return min(map(len, self.seeds.values()))

    @property
    def n_trials(self) -> int:
        """The smallest number of trials in it."""
        return min(self.sizes)

    @cached_property
    def _parts(self) -> tuple[tuple[float, float, float], ...]:
        """Independent parts of the variance: how large each is, how large it was estimated, in how many degrees."""
        length = max(self.sizes)
        of_trial = np.zeros(length)
        found = []
        for controller, adds in self.trials.items():
            mean = adds.mean(axis=0)
            of_trial[: len(mean)] += mean
            seeds = self.seeds[controller]
            count = len(seeds)
            if count > 1:
                own, degrees = float(seeds.var(ddof=1)), count - 1.0
                if controller in self.priors:
                    own, degrees = self.priors[controller].with_own(own, degrees)
                among = own / count
                owed = float(((adds - mean) ** 2).sum()) / (count * (count - 1))
                if among > owed:
                    found.append((among - owed, among, degrees))
        begin = 0
        for end in sorted(self.sizes):
            size = float((of_trial[begin:end] ** 2).sum())
            found.append((size, size, max(1.0, end - begin - 1.0)))
            begin = end
        return tuple(found)

    @property
    def standard_error(self) -> float:
        """Over other seeds, where there are several, and other trials; nan for a single trial."""
        return float(np.sqrt(sum(size for size, _, _ in self._parts)))

    @property
    def degrees(self) -> float:
        """Degrees of freedom of the standard error."""
        below = sum(estimated**2 / degrees for _, estimated, degrees in self._parts)
        return float(self.standard_error**4 / below) if below > 0.0 else np.inf

    def interval(self, share: float = SHARE) -> tuple[float, float]:
        """Return where the figure lies in ``share`` of the cases; nan for a single trial."""
        error = self.standard_error
        reach = 0.0 if error == 0.0 else float(stdtrit(self.degrees, 0.5 + share / 2.0)) * error
        return self.value - reach, self.value + reach


def alike(figures: Mapping[str, Nested]) -> dict[str, Nested]:
    """Return the same figure of several controllers, by their names, each told by the others how far seeds differ.

    The prior of a controller is the mean variance between the seeds of each other one that has several, as if it came
    from `PRIOR_DEGREES` degrees of freedom, or fewer where the others are few.
    """
    own = {
        name: (float(seeds.var(ddof=1)), len(seeds) - 1.0)
        for name, figure in figures.items()
        if len(seeds := figure.seeds[name]) > 1
    }
    found = dict(figures)
    for name in own:
        others = np.array([one for label, one in own.items() if label != name])
        if len(others):
            variances, degrees = others.T
            worth = 1.0 / (1.0 / PRIOR_DEGREES + 1.0 / degrees.sum())
            prior = Prior(float(np.average(variances, weights=degrees)), float(worth))
            found[name] = replace(figures[name], priors={**figures[name].priors, name: prior})
    return found


def regrets(figures: Mapping[str, Nested]) -> dict[str, Nested]:
    """Return by how much each of ``figures`` falls short of the best other one: what taking it costs.

    What is below 0 costs nothing. Where several are equally good the best is so by chance, too, and what it is better
    by is a little too much. Of a single figure there is nothing to tell.
    """
    found = {}
    for name, figure in figures.items():
        others = [other for label, other in figures.items() if label != name]
        if others:
            found[name] = max(others, key=lambda other: other.value) - figure
    return found


def _sum(value: float, parts: Sequence[tuple[float, Nested]]) -> Nested:
    """Return the weighted sum of figures: what one controller adds to several of them adds up, trial by trial.

    What others tell of a controller that is in one of them alone stays with it; of the sum of two they tell nothing.
    """
    seeds: dict[str, Array] = {}
    trials: dict[str, Array] = {}
    priors: dict[str, Prior] = {}
    for weight, figure in parts:
        for controller, prior in figure.priors.items():
            if sum(controller in other.seeds for _, other in parts) == 1:
                priors[controller] = replace(prior, variance=weight**2 * prior.variance)
        for controller, adds in figure.trials.items():
            own, length = weight * figure.seeds[controller], adds.shape[1]
            if controller not in seeds:
                seeds[controller], trials[controller] = own, weight * adds
                continue
            if len(own) != len(seeds[controller]):
                raise InvalidArgument(
                    f"{controller}: expected figures of the same evolution seeds, got {len(seeds[controller])} and "
                    f"{len(own)}"
                )
            longest = max(length, trials[controller].shape[1])
            padded = [np.pad(a, ((0, 0), (0, longest - a.shape[1]))) for a in (trials[controller], weight * adds)]
            seeds[controller], trials[controller] = seeds[controller] + own, padded[0] + padded[1]
    return Nested(value, seeds, trials, frozenset().union(*(figure.sizes for _, figure in parts)), priors)
