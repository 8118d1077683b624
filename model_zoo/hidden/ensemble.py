"""Several small networks with hidden states, trained on free runs: begun, chosen, gated, averaged."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import cycle, islice
from typing import ClassVar, Self

import numpy as np

from model_zoo.hidden.family import StateSpaceModel
from model_zoo.hidden.learning import Lesson, joined
from model_zoo.hidden.mixtures import MIXTURES, Mixture, networks, padded, widened
from model_zoo.hidden.shooting import Spaces, Trained, train
from model_zoo.linear_state_space import STEPS, LinearStateSpace
from sysid_evo.arrays import Array
from sysid_evo.cross_validation import time_blocks
from sysid_evo.data import Dataset
from sysid_evo.free_run import judging_windows, simulation_error
from sysid_evo.hyperparameters import Limit, at_least
from sysid_evo.progress import Counter, Progress

FEWEST_STATES, MOST_STATES, ORDERS = 2, 6, 3
"""Orders that are tried, so many in any case."""
FINALISTS, FURTHER = 2, 3
"""Orders whose networks are trained further, and how many of them go on to long runs."""
WIDER = 3
"""How often networks may become wider."""
LIKELY = 4
"""Mixtures of units of which more networks are begun, and networks of an order that are judged."""
SHARPNESS = 40.0
"""How fast a member counts less as its criterion, for each sample, is higher."""
ASTRAY = 10.0
"""What the criterion of a member that goes astray is higher."""
NEGLIGIBLE = 0.08
"""Weight, as a share of the largest, below which a member is left out."""
FEW, FOLDS, BETTER = 600, 3, 0.9
"""A record of fewer samples is gated: on so many folds networks must be better by this factor."""
LEARNED = ("outer_", "inner_", "kinds_", "output_", "offset_", "gain_", "first_", "history_", "rest_")


@dataclass(frozen=True)
class Beginning:
    """What begins at one order: the ``linear`` space, and ``networks``, one of each mixture, trained a little.

    ``found`` is the lowest criterion of those networks on long free runs from history.
    """

    linear: Trained
    networks: Trained
    found: float

    def likely(self, lesson: Lesson) -> list[Mixture]:
        """Return the mixtures of the best networks, the best first."""
        scores = criterion(self.networks.error, self.networks.spaces, lesson)
        return [MIXTURES[i] for i in np.argsort(scores)[:LIKELY]]


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
        ny = dataset.system.nx
        least = max(FEWEST_STATES, ny)
        orders = [max(self.order, ny)] if self.order else list(range(least, max(MOST_STATES, least + ORDERS - 1) + 1))
        parts = (3 * len(orders) + 3 * FINALISTS + 3 + 2 * WIDER) * self.trial + 2 * self.iterations + 1
        counter = Counter(progress, parts)
        lesson = Lesson.of(dataset, self.horizon, flow=self.continuous)
        tried = self._of_orders(lesson, orders, rng, counter)
        begun = self._finalist(lesson, sorted(tried, key=lambda one: one.found), counter)
        likely = begun.likely(lesson)
        more = self._begun(lesson, begun.linear, list(islice(cycle(likely), 2 * self.members)), rng, counter)
        pool = joined(begun.networks, more)
        pool = lesson.learned(pool.spaces, pool.starts, 2 * self.trial, counter.advance)
        trained = best(pool, lesson, self.members)
        trained = lesson.learned(trained.spaces, trained.starts, self.iterations, counter.advance)
        trained = lesson.lengthened(trained, begun.linear.spaces, self.iterations, counter.advance)
        trained = self._wide_enough(lesson, trained, likely, rng, counter)
        self._mean_of(lesson, trained, [one.linear for one in tried])
        if self.gated and not self.linear_order_ and dataset.n_steps < FEW:
            self._gate(dataset, rng)
        counter.advance()
        return self

    def _begun(
        self, lesson: Lesson, linear: Trained, mixtures: list[Mixture], rng: np.random.Generator, counter: Counter
    ) -> Trained:
        """Return networks of these mixtures that begin at a linear space, trained a little."""
        spaces = networks(linear.spaces, mixtures, self.hidden, rng)
        starts = lesson.states(linear, lesson.long)[:, lesson.short.begins].repeat(len(mixtures), axis=0)
        return lesson.learned(spaces, starts, self.trial, counter.advance)

    def _of_orders(
        self, lesson: Lesson, orders: list[int], rng: np.random.Generator, counter: Counter
    ) -> list[Beginning]:
        """Return what begins at each order: on until none of the last two is the best, `ORDERS` in any case."""
        tried: list[Beginning] = []
        mixtures = list(MIXTURES[: self.mixtures])
        for order in orders:
            linear = lesson.linear_trained(order, self.trial, self.trial, counter.advance)
            own = self._begun(lesson, linear, mixtures, rng, counter)
            tried.append(Beginning(linear, own, from_history(best(own, lesson, LIKELY), lesson)))
            if len(tried) - int(np.argmin([one.found for one in tried])) >= ORDERS:
                break
        counter.advance(3 * self.trial * (len(orders) - len(tried)))
        return tried

    def _finalist(self, lesson: Lesson, tried: list[Beginning], counter: Counter) -> Beginning:
        """Return that of the first `FINALISTS` whose networks, trained further, run best from history."""
        finalists = tried[:FINALISTS] if len(tried) > 1 else []
        scores = []
        for one in finalists:
            own = best(one.networks, lesson, LIKELY)
            own = best(lesson.learned(own.spaces, own.starts, 2 * self.trial, counter.advance), lesson, FURTHER)
            own = lesson.lengthened(own, one.linear.spaces, self.trial, counter.advance)
            scores.append(from_history(own, lesson))
        counter.advance(3 * self.trial * (FINALISTS - len(scores)))
        return finalists[int(np.argmin(scores))] if scores else tried[0]

    def _wide_enough(
        self, lesson: Lesson, trained: Trained, likely: list[Mixture], rng: np.random.Generator, counter: Counter
    ) -> Trained:
        """Return the best of these networks and of wider ones that begin at them, while wider is better."""
        mixtures = list(islice(cycle(likely), len(trained.spaces)))
        for left in range(WIDER, 0, -1):
            spaces = widened(trained.spaces, mixtures, self.hidden, rng)
            wider = train(spaces, lesson.long, trained.starts, 2 * self.trial, counter.advance)
            both = joined(replace(trained, spaces=padded(trained.spaces, self.hidden)), wider)
            found = criterion(lesson.judged(both)[1], both.spaces, lesson)
            if found[len(mixtures) :].min() >= found[: len(mixtures)].min():
                counter.advance(2 * self.trial * (left - 1))
                break
            trained = both[np.argsort(found)[: len(mixtures)]]
        return trained

    def uses(self) -> tuple[str, ...]:
        return ("linear_state_space",) if self.gated else ()

    @property
    def fit_note(self) -> str:
        said = [super().fit_note]
        if getattr(self, "linear_order_", 0):
            said.append(
                f"the recording does not tell the weights of a network: this is a linear state space of order "
                f"{self.linear_order_}"
            )
        return "; ".join(sentence for sentence in said if sentence)

    def _gate(self, dataset: Dataset, rng: np.random.Generator) -> None:
        """Become a linear state space unless networks are a tenth better in free runs on held-out blocks of time."""
        seed = int(rng.integers(2**63))
        plain = LinearStateSpace(
            folds=1, order=self.order, iterations=self.iterations, horizon=self.horizon, rest_hold=self.rest_hold
        )
        networks, errors = self.variant(gated=False), [0.0, 0.0]
        for learned, held in (time_blocks(dataset, fold, FOLDS) for fold in range(FOLDS)):
            for i, model in enumerate((networks, plain)):
                model.fit(learned, rng=np.random.default_rng(seed))
                windows = judging_windows(held, model.n_lags, fewest=STEPS)
                errors[i] += float(np.nan_to_num(simulation_error(model, windows), nan=np.inf))
        if errors[0] <= BETTER * errors[1]:
            return
        plain.fit(dataset, rng=np.random.default_rng(seed))
        for name in LEARNED:
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


def best(trained: Trained, lesson: Lesson, count: int) -> Trained:
    """Return the ``count`` networks whose criterion is lowest, the best first."""
    return trained[np.argsort(criterion(trained.error, trained.spaces, lesson))[:count]]


def from_history(trained: Trained, lesson: Lesson) -> float:
    """Return the lowest criterion of networks on long free runs that begin where observers find the state."""
    long = trained if trained.starts.shape[1] == len(lesson.long) else lesson.at_length(trained)
    return float(criterion(lesson.judged(long)[1], trained.spaces, lesson).min())


def criterion(errors: Array, spaces: Spaces, lesson: Lesson) -> Array:
    """Return the Bayesian information criterion (S,) for each sample: log ``errors`` (S,) + P log(N) / N."""
    count = sum(part.outputs.size for part in lesson.parts)
    known = np.where(np.isfinite(errors), np.maximum(errors, 1e-12), 1e6)
    return np.asarray(np.log(known) + (~spaces.blind).sum(axis=1) * np.log(count) / count)
