"""Families nonlinear_state_space and latent_ode: several small networks, chosen and averaged."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import cycle, islice
from typing import Any, ClassVar, Self

import numpy as np

from model_zoo.state_space.estimation import EstimationProblem, joined
from model_zoo.state_space.linear_state_space import STEPS, LinearStateSpace
from model_zoo.state_space.model import StateSpaceModel
from model_zoo.state_space.shooting import StateSpaceBatch, Trained, train
from model_zoo.state_space.units import MIXTURES, UNITS, Mixture
from sysid_evo import register_model
from sysid_evo.data import Dataset
from sysid_evo.models.parameters import Limit, at_least
from sysid_evo.progress import Counter, Progress
from sysid_evo.types import Array, IntArray
from sysid_evo.validation.folds import FOLDS, time_fold
from sysid_evo.validation.simulation_error import error_windows, simulation_error

MIN_STATES, MAX_STATES, ORDERS = 2, 6, 3
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

FEW, BETTER = 600, 0.9
"""A record of fewer samples is gated: on held-out blocks of time networks must be better by this factor."""

LEARNED = ("outer_", "inner_", "kinds_", "output_", "offset_", "gain_", "first_", "n_lags_", "rest_")


class NetworkStateSpace(StateSpaceModel):
    """The weighted mean of several small networks with hidden states of their own, trained on free runs.

    ``continuous`` says whether they are differential equations. How they are chosen is told by `NonlinearStateSpace`.
    """

    continuous: ClassVar[bool]
    limits: ClassVar[dict[str, Limit]] = {
        name: at_least(1) for name in ("members", "mixtures", "hidden", "screening_iterations")
    }

    order: int | None = None
    members: int = 6
    mixtures: int = len(MIXTURES)
    hidden: int = 6
    screening_iterations: int = 15
    iterations: int = 60
    horizon: int = 1000
    gated: bool = True
    dead_band: bool = False
    max_steps: int | None = 30_000

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        ny = dataset.system.nx
        least = max(MIN_STATES, ny)
        orders = [max(self.order, ny)] if self.order else list(range(least, max(MAX_STATES, least + ORDERS - 1) + 1))
        parts = (3 * len(orders) + 3 * FINALISTS + 3 + 2 * WIDER) * self.screening_iterations + 2 * self.iterations + 1
        counter = Counter(progress, parts)
        lesson = EstimationProblem.of(dataset, self.horizon, flow=self.continuous)
        tried = self._of_orders(lesson, orders, rng, counter)
        begun = self._finalist(lesson, sorted(tried, key=lambda one: one.found), counter)
        likely = begun.likely(lesson)
        more = self._begun(lesson, begun.linear, list(islice(cycle(likely), 2 * self.members)), rng, counter)
        pool = joined(begun.networks, more)
        pool = lesson.learned(pool.spaces, pool.starts, 2 * self.screening_iterations, counter.advance)
        trained = best_networks(pool, lesson, self.members)
        trained = lesson.learned(trained.spaces, trained.starts, self.iterations, counter.advance)
        trained = lesson.lengthened(trained, begun.linear.spaces, self.iterations, counter.advance)
        trained = self._wide_enough(lesson, trained, likely, rng, counter)
        self._mean_of(lesson, trained, [one.linear for one in tried])
        if self.gated and not self.linear_order_ and dataset.n_steps < FEW:
            self._gate(dataset, rng)
        counter.advance()
        return self

    def _begun(
        self,
        lesson: EstimationProblem,
        linear: Trained,
        mixtures: list[Mixture],
        rng: np.random.Generator,
        counter: Counter,
    ) -> Trained:
        """Return networks of these mixtures that begin at a linear space, trained a little."""
        spaces = networks(linear.spaces, mixtures, self.hidden, rng)
        starts = lesson.states(linear, lesson.long)[:, lesson.short.begins].repeat(len(mixtures), axis=0)
        return lesson.learned(spaces, starts, self.screening_iterations, counter.advance)

    def _of_orders(
        self, lesson: EstimationProblem, orders: list[int], rng: np.random.Generator, counter: Counter
    ) -> list[OrderCandidate]:
        """Return what begins at each order: on until none of the last two is the best, `ORDERS` in any case."""
        tried: list[OrderCandidate] = []
        mixtures = list(MIXTURES[: self.mixtures])
        for order in orders:
            linear = lesson.linear_trained(order, self.screening_iterations, self.screening_iterations, counter.advance)
            own = self._begun(lesson, linear, mixtures, rng, counter)
            tried.append(OrderCandidate(linear, own, from_history(best_networks(own, lesson, LIKELY), lesson)))
            if len(tried) - int(np.argmin([one.found for one in tried])) >= ORDERS:
                break
        counter.advance(3 * self.screening_iterations * (len(orders) - len(tried)))
        return tried

    def _finalist(self, lesson: EstimationProblem, tried: list[OrderCandidate], counter: Counter) -> OrderCandidate:
        """Return that of the first `FINALISTS` whose networks, trained further, run best from history."""
        finalists = tried[:FINALISTS] if len(tried) > 1 else []
        scores = []
        for one in finalists:
            own = best_networks(one.networks, lesson, LIKELY)
            own = lesson.learned(own.spaces, own.starts, 2 * self.screening_iterations, counter.advance)
            own = lesson.lengthened(
                best_networks(own, lesson, FURTHER), one.linear.spaces, self.screening_iterations, counter.advance
            )
            scores.append(from_history(own, lesson))
        counter.advance(3 * self.screening_iterations * (FINALISTS - len(scores)))
        return finalists[int(np.argmin(scores))] if scores else tried[0]

    def _wide_enough(
        self,
        lesson: EstimationProblem,
        trained: Trained,
        likely: list[Mixture],
        rng: np.random.Generator,
        counter: Counter,
    ) -> Trained:
        """Return the best of these networks and of wider ones that begin at them, while wider is better."""
        mixtures = list(islice(cycle(likely), len(trained.spaces)))
        for left in range(WIDER, 0, -1):
            spaces = widened(trained.spaces, mixtures, self.hidden, rng)
            wider = train(spaces, lesson.long, trained.starts, 2 * self.screening_iterations, counter.advance)
            both = joined(replace(trained, spaces=padded(trained.spaces, self.hidden)), wider)
            found = criterion(lesson.judged(both)[1], both.spaces, lesson)
            if found[len(mixtures) :].min() >= found[: len(mixtures)].min():
                counter.advance(2 * self.screening_iterations * (left - 1))
                break
            trained = both[np.argsort(found)[: len(mixtures)]]
        return trained

    def families_used(self) -> tuple[str, ...]:
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
            folds=1, order=self.order, iterations=self.iterations, horizon=self.horizon, dead_band=self.dead_band
        )
        networks, errors = self.variant(gated=False), [0.0, 0.0]
        for learned, held in (time_fold(dataset, fold, FOLDS) for fold in range(FOLDS)):
            for i, model in enumerate((networks, plain)):
                model.fit(learned, rng=np.random.default_rng(seed))
                windows = error_windows(held, model.n_lags, fewest=STEPS)
                errors[i] += float(np.nan_to_num(simulation_error(model, windows), nan=np.inf))
        if errors[0] <= BETTER * errors[1]:
            return
        plain.fit(dataset, rng=np.random.default_rng(seed))
        for name in LEARNED:
            setattr(self, name, getattr(plain, name))
        if self.flows:
            self.flow_ = False
        self.linear_order_ = len(self.rest_)

    def _mean_of(self, lesson: EstimationProblem, trained: Trained, linear: list[Trained]) -> None:
        """Become the mean of the networks, or the best linear space if its criterion is lower than all of theirs."""
        observers, found = lesson.judged(trained)
        found = criterion(found, trained.spaces, lesson)
        plain = [(own, *lesson.judged(own)) for own in linear]
        scores = [float(criterion(errors, own.spaces, lesson)[0]) for own, _, errors in plain]
        self.linear_order_ = 0
        if min(scores) <= found.min():
            own, of_it, _ = plain[int(np.argmin(scores))]
            self.linear_order_ = own.spaces.n
            self.set_learned(lesson.scales, [own.spaces], of_it, np.ones(1))
            return
        astray = lesson.escapes(trained.spaces, observers)
        found = found + np.where(astray & ~astray.all(), ASTRAY, 0.0)
        weights = np.exp(-SHARPNESS * (found - found.min()))
        kept = np.flatnonzero(weights > NEGLIGIBLE).tolist()
        chosen = [observers[i] for i in kept]
        self.set_learned(
            lesson.scales, [trained.spaces[[i]] for i in kept], chosen, weights[kept] / weights[kept].sum()
        )


@register_model("nonlinear_state_space")
class NonlinearStateSpace(NetworkStateSpace):
    """x' = A x + B u + c + W units(V (x, u, 1)) + K (y - C x - d), y = C x + d: free runs fitted by shooting.

    It begins at linear state spaces (subspace and output error) of ascending orders, from 2 or the number of outputs
    on to 6 at most, unless ``order`` is given. From each begin networks of ``hidden`` units, of each of so many
    ``mixtures`` of kinds: smooth (tanh), kinked, sharply kinked, cubic, products, and units that see the controls
    alone. They are trained by Levenberg-Marquardt with analytic gradients on free runs of 100 and at last of
    ``horizon`` steps, the initial state of each free, with a normal prior on W and V; residuals that are alike for long
    count less. After ``screening_iterations`` iterations they are judged by the Bayesian information criterion (Schwarz
    1978) of long free runs that begin where an observer finds the state; no higher order is tried once two in a row are
    no better. The best networks of the best two orders go on, and the lower criterion decides. More networks of that
    order begin with the mixtures that did best, and after twice ``screening_iterations`` further iterations the best
    ``members`` of all go on for ``iterations``, and for as many on long runs. While wider ones that begin at them, of
    ``hidden`` more units, have a lower criterion, these join them. The output is the mean of the best, in which one
    counts less the higher its criterion is, and one that goes astray under the recorded controls in another order not
    at all; each has its own hidden states and its own gain K.

    Where the criterion of a linear space is lower than that of every network, that one is the model. Of a record
    of less than 600 samples, which may not tell so many weights, `linear_state_space` is the model unless networks are
    a tenth better in free runs on held-out blocks of time; ``gated=False`` leaves that out. ``fit_note`` says so.
    """

    knowledge = "black"

    presets: ClassVar[dict[str, dict[str, Any]]] = {
        "quick": {
            "members": 3,
            "mixtures": 4,
            "screening_iterations": 6,
            "iterations": 15,
            "horizon": 300,
            "max_steps": 3000,
        }
    }
    continuous: ClassVar[bool] = False


@register_model("latent_ode")
class LatentOde(NetworkStateSpace):
    """dx/dt = A x + B u + c + W units(V (x, u, 1)), y = C x + d, the control held over a sample; + K (y - C x - d).

    A neural ODE (Chen et al. 2018) of which outputs alone are measured: of the states x the first are the outputs
    without noise, the others are latent. One step of the classical Runge-Kutta method takes them from sample to sample.
    It begins at linear differential equations of ascending orders, whose step is that of linear state spaces found by a
    subspace method, and is trained, chosen and averaged as `NonlinearStateSpace` is: Levenberg-Marquardt on free runs
    of 100 and at last of ``horizon`` steps through the derivatives of the Runge-Kutta steps, the initial state of each
    run free (multiple shooting), a normal prior on W and V. An observer with the gain K of a Kalman predictor corrects
    the states after each step where outputs are measured, and finds the first from the last samples.
    """

    knowledge = "black"

    presets: ClassVar[dict[str, dict[str, Any]]] = {
        "quick": {
            "members": 2,
            "mixtures": 3,
            "screening_iterations": 5,
            "iterations": 10,
            "horizon": 200,
            "max_steps": 3000,
        }
    }
    continuous: ClassVar[bool] = True


@dataclass(frozen=True)
class OrderCandidate:
    """What begins at one order: the ``linear`` space, and ``networks``, one of each mixture, trained a little.

    ``found`` is the lowest criterion of those networks on long free runs from history.
    """

    linear: Trained
    networks: Trained
    found: float

    def likely(self, lesson: EstimationProblem) -> list[Mixture]:
        """Return the mixtures of the best networks, the best first."""
        scores = criterion(self.networks.error, self.networks.spaces, lesson)
        return [MIXTURES[i] for i in np.argsort(scores)[:LIKELY]]


def best_networks(trained: Trained, lesson: EstimationProblem, count: int) -> Trained:
    """Return the ``count`` networks whose criterion is lowest, the best first."""
    return trained[np.argsort(criterion(trained.error, trained.spaces, lesson))[:count]]


def from_history(trained: Trained, lesson: EstimationProblem) -> float:
    """Return the lowest criterion of networks on long free runs that begin where observers find the state."""
    long = trained if trained.starts.shape[1] == len(lesson.long) else lesson.at_length(trained)
    return float(criterion(lesson.judged(long)[1], trained.spaces, lesson).min())


def criterion(errors: Array, spaces: StateSpaceBatch, lesson: EstimationProblem) -> Array:
    """Return the Bayesian information criterion (S,) for each sample: log ``errors`` (S,) + P log(N) / N."""
    count = sum(part.outputs.size for part in lesson.parts)
    known = np.where(np.isfinite(errors), np.maximum(errors, 1e-12), 1e6)
    return np.asarray(np.log(known) + (~spaces.blind).sum(axis=1) * np.log(count) / count)


SPREAD = 0.7
"""Deviation of the weights into the units at the start."""
STEEPER = 2.0
"""Times as much into units that see the controls alone, which are few."""


def networks(
    linear: StateSpaceBatch, mixtures: list[Mixture], hidden: int, rng: np.random.Generator
) -> StateSpaceBatch:
    """Return one space for each mixture that steps as the ``linear`` one, with units that have no weight yet."""
    count = len(mixtures)
    several = replace(
        linear,
        outer=linear.outer.repeat(count, axis=0),
        inner=linear.inner.repeat(count, axis=0),
        kinds=linear.kinds.repeat(count, axis=0),
    )
    return widened(several, mixtures, hidden, rng)


def widened(
    spaces: StateSpaceBatch, mixtures: list[Mixture], further: int, rng: np.random.Generator
) -> StateSpaceBatch:
    """Return spaces that step as these do, with ``further`` units each, of so many mixtures, without weight yet."""
    count, n, seen = len(spaces), spaces.n, spaces.inner.shape[2]
    inner: Array = SPREAD * rng.standard_normal((count, further, seen))
    kinds = np.zeros((count, further), dtype=np.int64)
    for s, mixture in enumerate(mixtures):
        for h in range(further):
            unit = mixture[h % len(mixture)]
            if unit is None:
                inner[s, h] = 0.0
                continue
            kinds[s, h] = UNITS.index(unit.kind)
            if unit.controls:
                inner[s, h] *= np.where(np.arange(seen) < n, 0.0, STEEPER)
    return _appended(spaces, inner, kinds)


def padded(spaces: StateSpaceBatch, further: int) -> StateSpaceBatch:
    """Return the same spaces with ``further`` units that are nothing, so that they stand beside wider ones."""
    kinds = np.zeros((len(spaces), further), dtype=np.int64)
    return _appended(spaces, np.zeros((len(spaces), further, spaces.inner.shape[2])), kinds)


def _appended(spaces: StateSpaceBatch, inner: Array, kinds: IntArray) -> StateSpaceBatch:
    """Return the spaces with units (S, h) whose weights into the states are 0."""
    return replace(
        spaces,
        outer=np.concatenate([spaces.outer, np.zeros((len(spaces), spaces.n, kinds.shape[1]))], axis=2),
        inner=np.concatenate([spaces.inner, inner], axis=1),
        kinds=np.concatenate([spaces.kinds, kinds], axis=1),
    )
