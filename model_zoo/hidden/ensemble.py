"""Several small networks with hidden states, trained on free runs: begun, chosen, gated, averaged."""

from __future__ import annotations

from itertools import cycle, islice
from typing import ClassVar, Self

import numpy as np

from model_zoo.hidden.family import StateSpaceModel
from model_zoo.hidden.gate import LINEAR, linear_instead
from model_zoo.hidden.learning import Lesson, joined
from model_zoo.hidden.mixtures import MIXTURES, Mixture, networks
from model_zoo.hidden.shooting import Spaces, Trained
from sysid_evo.arrays import Array
from sysid_evo.data import Dataset
from sysid_evo.hyperparameters import Limit, at_least
from sysid_evo.progress import Counter, Progress

FEWEST_STATES, ORDERS = 2, 3
LIKELY = 4
"""Mixtures of units of which more networks are begun."""
SHARPNESS = 40.0
"""How fast a member counts less as its criterion, for each sample, is higher."""
ASTRAY = 10.0
"""What the criterion of a member that goes astray is higher."""
NEGLIGIBLE = 0.08
"""Weight, as a share of the largest, below which a member is left out."""


class NetworkSpaces(StateSpaceModel):
    """The weighted mean of several small networks with hidden states of their own, trained on free runs.

    ``continuous`` says whether they are differential equations. How they are chosen is told by `NonlinearStateSpace`.
    """

    continuous: ClassVar[bool]
    limits: ClassVar[dict[str, Limit]] = {name: at_least(1) for name in ("members", "mixtures", "hidden", "trial")}

    order: int | None = None
    members: int = 6
    mixtures: int = len(MIXTURES)
    hidden: int = 6
    trial: int = 15
    iterations: int = 60
    horizon: int = 1000
    gated: bool = True
    rest_hold: bool = False
    most_steps: int | None = 30_000

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        least = max(FEWEST_STATES, dataset.system.nx)
        orders = [max(self.order, dataset.system.nx)] if self.order else [least + more for more in range(ORDERS)]
        counter = Counter(progress, (3 * len(orders) + 3) * self.trial + 2 * self.iterations + 1)
        lesson = Lesson.of(dataset, self.horizon, flow=self.continuous)
        linear = {order: lesson.linear_trained(order, self.trial, self.trial, counter.advance) for order in orders}

        def begun(order: int, mixtures: list[Mixture]) -> Trained:
            count = len(mixtures)
            spaces = networks(linear[order].spaces, mixtures, self.hidden, rng)
            starts = lesson.states(linear[order], lesson.long)[:, lesson.short.begins].repeat(count, axis=0)
            return lesson.learned(spaces, starts, self.trial, counter.advance)

        tried = {order: begun(order, list(MIXTURES[: self.mixtures])) for order in orders}
        scores = {order: criterion(own.error, own.spaces, lesson) for order, own in tried.items()}
        order = min(orders, key=lambda order: scores[order].min())
        likely = [MIXTURES[i] for i in np.argsort(scores[order])[:LIKELY]]
        pool = joined(tried[order], begun(order, list(islice(cycle(likely), 2 * self.members))))
        pool = lesson.learned(pool.spaces, pool.starts, 2 * self.trial, counter.advance)
        trained = pool[np.argsort(criterion(pool.error, pool.spaces, lesson))[: self.members]]
        trained = lesson.learned(trained.spaces, trained.starts, self.iterations, counter.advance)
        trained = lesson.lengthened(trained, linear[order].spaces, self.iterations, counter.advance)
        self._mean_of(lesson, trained, list(linear.values()))
        if self.gated and not self.linear_order_:
            settings = {"order": self.order, "iterations": self.iterations, "horizon": self.horizon}
            trial = self.variant(gated=False)
            self.replaced_by(linear_instead(trial, dataset, rng, rest_hold=self.rest_hold, **settings))
        counter.advance()
        return self

    def uses(self) -> tuple[str, ...]:
        return (LINEAR,) if self.gated else ()

    def _mean_of(self, lesson: Lesson, trained: Trained, linear: list[Trained]) -> None:
        """Become the mean of the networks, or the best linear space if its criterion is lower than all of theirs."""
        observers, found = lesson.judged(trained)
        found = criterion(found, trained.spaces, lesson)
        plain = [(own, *lesson.judged(own)) for own in linear]
        scores = [float(criterion(errors, own.spaces, lesson)[0]) for own, _, errors in plain]
        self.linear_order_ = 0
        if min(scores) <= found.min():
            own, of_it, _ = plain[int(np.argmin(scores))]
            self.linear_order_ = own.spaces.n
            self.adopt(lesson.scales, [own.spaces], of_it, np.ones(1))
            return
        astray = lesson.escapes(trained.spaces, observers)
        found = found + np.where(astray & ~astray.all(), ASTRAY, 0.0)
        weights = np.exp(-SHARPNESS * (found - found.min()))
        kept = np.flatnonzero(weights > NEGLIGIBLE).tolist()
        chosen = [observers[i] for i in kept]
        self.adopt(lesson.scales, [trained.spaces[[i]] for i in kept], chosen, weights[kept] / weights[kept].sum())


def criterion(errors: Array, spaces: Spaces, lesson: Lesson) -> Array:
    """Return the Bayesian information criterion (S,) for each sample: log ``errors`` (S,) + P log(N) / N."""
    count = sum(part.outputs.size for part in lesson.parts)
    known = np.where(np.isfinite(errors), np.maximum(errors, 1e-12), 1e6)
    return np.asarray(np.log(known) + (~spaces.blind).sum(axis=1) * np.log(count) / count)
