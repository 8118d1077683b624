"""Several small networks with hidden states, trained on free runs: begun, chosen, gated, averaged."""

from __future__ import annotations

from itertools import cycle, islice
from typing import ClassVar, Self

import numpy as np

from model_zoo.hidden.family import StateSpaceModel
from model_zoo.hidden.learning import Lesson, joined
from model_zoo.hidden.mixtures import MIXTURES, Mixture, networks
from model_zoo.hidden.shooting import Spaces, Trained
from model_zoo.linear_state_space import STEPS
from sysid_evo.arrays import Array
from sysid_evo.cross_validation import time_blocks
from sysid_evo.data import Dataset
from sysid_evo.free_run import judging_windows, simulation_error
from sysid_evo.hyperparameters import Limit, at_least
from sysid_evo.progress import Counter, Progress
from sysid_evo.registry import make_model

LINEAR = "linear_state_space"
FEWEST_STATES, ORDERS = 2, 3
LIKELY = 4
"""Mixtures of units of which more networks are begun."""
SHARPNESS = 40.0
"""How fast a member counts less as its criterion, for each sample, is higher."""
ASTRAY = 10.0
"""What the criterion of a member that goes astray is higher."""
FEW, GATE_FOLDS, BETTER = 600, 3, 0.9
"""A record of fewer samples is gated: on so many folds networks must be better by this factor."""
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
        if self.gated and sum(len(part) for part in lesson.parts) < FEW and not self.linear_order_:
            self._gate(dataset, int(rng.integers(2**63)))
        counter.advance()
        return self

    def uses(self) -> tuple[str, ...]:
        return (LINEAR,) if self.gated else ()

    def _gate(self, dataset: Dataset, seed: int) -> None:
        """Become the linear state space, unless networks are better in free runs on held-out blocks of time."""
        plain = make_model(
            LINEAR,
            order=self.order,
            iterations=self.iterations,
            horizon=self.horizon,
            folds=1,
            rest_hold=self.rest_hold,
        )
        errors = [0.0, 0.0]
        for learned, held in (time_blocks(dataset, fold, GATE_FOLDS) for fold in range(GATE_FOLDS)):
            for i, model in enumerate((self.variant(gated=False), plain)):
                model.fit(learned, rng=np.random.default_rng(seed))
                windows = judging_windows(held, model.n_lags, fewest=STEPS)
                errors[i] += float(np.nan_to_num(simulation_error(model, windows), nan=np.inf))
        if errors[0] <= BETTER * errors[1]:
            return
        plain.fit(dataset, rng=np.random.default_rng(seed))
        for name in ("outer_", "inner_", "kinds_", "output_", "offset_", "gain_", "first_", "history_", "rest_"):
            setattr(self, name, getattr(plain, name))
        if self.flows:
            self.flow_ = False
        self.linear_order_ = len(self.rest_)

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

    @property
    def fit_note(self) -> str:
        said = [super().fit_note]
        if getattr(self, "linear_order_", 0):
            said.append(
                f"the recording does not tell the weights of a network: this is a linear state space of order "
                f"{self.linear_order_}"
            )
        return "; ".join(sentence for sentence in said if sentence)


def criterion(errors: Array, spaces: Spaces, lesson: Lesson) -> Array:
    """Return the Bayesian information criterion (S,) for each sample: log ``errors`` (S,) + P log(N) / N."""
    count = sum(part.outputs.size for part in lesson.parts)
    known = np.where(np.isfinite(errors), np.maximum(errors, 1e-12), 1e6)
    return np.asarray(np.log(known) + (~spaces.blind).sum(axis=1) * np.log(count) / count)
