"""Families nonlinear_state_space and latent_ode: several small networks, selected and averaged."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import cycle, islice
from typing import Any, ClassVar, Self

import numpy as np

from model_zoo.state_space.estimation import EstimationProblem, StateObserver, joined
from model_zoo.state_space.linear_state_space import STEPS, LinearStateSpace
from model_zoo.state_space.model import StateSpaceModel
from model_zoo.state_space.shooting import StateSpaceBatch, Trained, train
from model_zoo.state_space.units import MIXTURES, UNITS, Mixture
from sysid_evo import register_model
from sysid_evo.data import Dataset
from sysid_evo.models.parameters import Limit, at_least
from sysid_evo.progress import Counter, Progress
from sysid_evo.types import Array, BoolArray, IntArray
from sysid_evo.validation.folds import FOLDS, time_fold
from sysid_evo.validation.simulation_error import error_windows, simulation_error

MIN_STATES, MAX_STATES, ORDERS = 2, 6, 3
"""Lowest and highest order that is tried, and how many are tried in any case."""
FINALISTS, COMPARABLE = 2, 1.0
"""Most orders whose networks are averaged, and how far the criterion of the second may be above that of the best."""
MAX_WIDENINGS = 3
"""How often networks may become wider."""
N_MIXTURES = 4
"""Number of unit mixtures from which further networks start, and of networks scored per order."""
SHARPNESS = 4.0
"""How fast the weight of a member falls with its criterion per sample."""
UNDETERMINED = 0.5
"""Share of diverging members from which on all members of an order are left out."""
NEGLIGIBLE = 0.2
"""Weight, as a share of the largest, below which a member is left out."""

FEW_SAMPLES, REQUIRED_RATIO = 600, 0.9
"""With fewer samples, networks must have this much lower an error on held-out blocks of time."""

LEARNED = ("outer_", "inner_", "kinds_", "output_", "offset_", "gain_", "first_", "n_lags_", "rest_")


class NetworkStateSpace(StateSpaceModel):
    """Weighted mean of several small networks with their own hidden states, trained on simulations.

    ``continuous`` families are differential equations. `NonlinearStateSpace` describes how networks are selected.
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
    max_steps: int | None = 30_000

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        ny = dataset.system.nx
        least = max(MIN_STATES, ny)
        orders = [max(self.order, ny)] if self.order else list(range(least, max(MAX_STATES, least + ORDERS - 1) + 1))
        each = (3 + 2 * MAX_WIDENINGS) * self.screening_iterations + 2 * self.iterations
        counter = Counter(progress, 3 * len(orders) * self.screening_iterations + FINALISTS * each + 1)
        problem = EstimationProblem.of(dataset, self.horizon, flow=self.continuous)
        tried = self._of_orders(problem, orders, rng, counter)
        ranked = sorted(tried, key=lambda one: one.found)
        finalists = [one for one in ranked[:FINALISTS] if one.found <= ranked[0].found + COMPARABLE]
        count = -(-self.members // len(finalists))
        trained = [self._continued(problem, one, count, rng, counter) for one in finalists]
        counter.advance((FINALISTS - len(finalists)) * each)
        self._mean_of(problem, trained, [one.linear for one in tried])
        if self.gated and not self.linear_order_ and dataset.n_steps < FEW_SAMPLES:
            self._gate(dataset, rng)
        counter.advance()
        return self

    def _started(
        self,
        problem: EstimationProblem,
        linear: Trained,
        mixtures: list[Mixture],
        rng: np.random.Generator,
        counter: Counter,
    ) -> Trained:
        """Return networks of these mixtures that start from a linear space, after a short training."""
        spaces = networks(linear.spaces, mixtures, self.hidden, rng)
        starts = problem.states(linear, problem.long)[:, problem.short.begins].repeat(len(mixtures), axis=0)
        return train(spaces, problem.short, starts, self.screening_iterations, counter.advance)

    def _of_orders(
        self, problem: EstimationProblem, orders: list[int], rng: np.random.Generator, counter: Counter
    ) -> list[OrderCandidate]:
        """Return the candidates of each order, until two orders in a row are no better (at least `ORDERS`)."""
        tried: list[OrderCandidate] = []
        mixtures = list(MIXTURES[: self.mixtures])
        for order in orders:
            linear = problem.linear_trained(
                order, self.screening_iterations, self.screening_iterations, counter.advance
            )
            own = self._started(problem, linear, mixtures, rng, counter)
            tried.append(OrderCandidate(linear, own, from_history(best_networks(own, problem, N_MIXTURES), problem)))
            if len(tried) - int(np.argmin([one.found for one in tried])) >= ORDERS:
                break
        counter.advance(3 * self.screening_iterations * (len(orders) - len(tried)))
        return tried

    def _continued(
        self, problem: EstimationProblem, one: OrderCandidate, count: int, rng: np.random.Generator, counter: Counter
    ) -> Trained:
        """Return ``count`` networks of one order, the best of those tried and of as many more, trained to the end."""
        scores = criterion(one.networks.error, one.networks.spaces, problem)
        likely = [MIXTURES[i] for i in np.argsort(scores)[:N_MIXTURES]]
        more = self._started(problem, one.linear, list(islice(cycle(likely), 2 * count)), rng, counter)
        pool = joined(one.networks, more)
        pool = train(pool.spaces, problem.short, pool.starts, 2 * self.screening_iterations, counter.advance)
        trained = best_networks(pool, problem, count)
        trained = train(trained.spaces, problem.short, trained.starts, self.iterations, counter.advance)
        trained = problem.lengthened(trained, one.linear.spaces, self.iterations, counter.advance)
        return self._wide_enough(problem, trained, likely, rng, counter)

    def _wide_enough(
        self,
        problem: EstimationProblem,
        trained: Trained,
        likely: list[Mixture],
        rng: np.random.Generator,
        counter: Counter,
    ) -> Trained:
        """Return the best of these networks and of wider ones that start from them, as long as wider is better."""
        mixtures = list(islice(cycle(likely), len(trained.spaces)))
        for left in range(MAX_WIDENINGS, 0, -1):
            spaces = widened(trained.spaces, mixtures, self.hidden, rng)
            wider = train(spaces, problem.long, trained.starts, 2 * self.screening_iterations, counter.advance)
            both = joined(replace(trained, spaces=padded(trained.spaces, self.hidden)), wider)
            found = criterion(problem.assessed(both)[1], both.spaces, problem)
            if found[len(mixtures) :].min() >= found[: len(mixtures)].min():
                counter.advance(2 * self.screening_iterations * (left - 1))
                break
            trained = both[np.argsort(found)[: len(mixtures)]]
        return trained

    def families_used(self) -> tuple[str, ...]:
        return ("linear_state_space",) if self.gated else ()

    @property
    def fit_note(self) -> str:
        notes = [super().fit_note]
        if getattr(self, "linear_order_", 0):
            notes.append(
                f"the recording is too short for a network: this is a linear state space of order {self.linear_order_}"
            )
        return "; ".join(sentence for sentence in notes if sentence)

    def _gate(self, dataset: Dataset, rng: np.random.Generator) -> None:
        """Become a linear state space unless networks simulate held-out blocks of time at least a tenth better."""
        seed = int(rng.integers(2**63))
        plain = LinearStateSpace(folds=1, order=self.order, iterations=self.iterations, horizon=self.horizon)
        networks, errors = self.variant(gated=False), [0.0, 0.0]
        for learned, held in (time_fold(dataset, fold, FOLDS) for fold in range(FOLDS)):
            for i, model in enumerate((networks, plain)):
                model.fit(learned, rng=np.random.default_rng(seed))
                windows = error_windows(held, model.n_lags, fewest=STEPS)
                errors[i] += float(np.nan_to_num(simulation_error(model, windows), nan=np.inf))
        if errors[0] <= REQUIRED_RATIO * errors[1]:
            return
        plain.fit(dataset, rng=np.random.default_rng(seed))
        for name in LEARNED:
            setattr(self, name, getattr(plain, name))
        if self.flows:
            self.flow_ = False
        self.linear_order_ = len(self.rest_)

    def _mean_of(self, problem: EstimationProblem, trained: list[Trained], linear: list[Trained]) -> None:
        """Become the mean of the networks, or the best linear space if its criterion is lower than all of theirs."""
        spaces, observers, found = members_of(trained, problem)
        plain, of_plain, scores = members_of(linear, problem)
        self.linear_order_ = 0
        if scores.min() <= found.min():
            best = int(np.argmin(scores))
            self.linear_order_ = plain[best].n
            self.set_learned(problem.scales, [plain[best]], [of_plain[best]], np.ones(1))
            return
        diverged = with_whole_orders(problem.escapes(spaces, observers), np.array([space.n for space in spaces]))
        weights = mean_weights(found, diverged, self.members)
        kept = np.flatnonzero(weights).tolist()
        self.set_learned(problem.scales, [spaces[i] for i in kept], [observers[i] for i in kept], weights[kept])


@register_model("nonlinear_state_space")
class NonlinearStateSpace(NetworkStateSpace):
    """Small networks with hidden states and observers, averaged; for systems with unmeasured states.

    x' = A x + B u + c + W units(V (x, u, 1)) + K (y - C x - d), y = C x + d, fitted to simulations (shooting). Training
    starts from linear state spaces (subspace, then output error) of ascending order, from 2 or the number of outputs to
    6, or of the given ``order``. From each start networks of ``hidden`` units, one for each of the first ``mixtures``
    kinds: smooth (tanh), kinked, sharply kinked, cubic, products, and units of the controls only. Levenberg-Marquardt
    with analytic gradients fits them to simulations of 100 and finally of ``horizon`` steps with free initial states
    and a normal prior on W and V; correlated residuals count less. After ``screening_iterations`` they are compared by
    the Bayesian information criterion (Schwarz 1978) of long simulations that start from the observer's estimate. The
    search ends after two orders without improvement. The two best orders are averaged, or only the best one if the
    other is far worse.

    More networks of both orders start with the best mixtures. After twice ``screening_iterations`` more, the best of
    all, half of the ``members`` for each order, are trained for ``iterations`` on short and on long simulations. Wider
    ones, with ``hidden`` more units, are added as long as they lower the criterion. The output is the mean of the best
    ``members``, with weights that fall slowly with the criterion. Networks that diverge under the recorded controls in
    another order are excluded, and with them an order of which at least half of the networks diverge. Each has its own
    hidden states and gain K.

    If a linear space has a lower criterion than all networks, it is the model. With fewer than 600 samples
    `linear_state_space` is the model unless networks simulate held-out blocks of time at least a tenth better;
    ``gated=False`` skips this test. ``fit_note`` reports the outcome.
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
    """Neural ODE with hidden states and an observer, averaged over networks; for systems with unmeasured states.

    dx/dt = A x + B u + c + W units(V (x, u, 1)), y = C x + d, with the control held over a sample, plus K (y - C x - d)
    after each step (Chen et al. 2018, with unmeasured states). The first states are the outputs without noise, the
    others are latent. One step of the classical Runge-Kutta method leads from sample to sample. Training starts from
    linear differential equations that are equivalent to identified linear state spaces; training, selection, averaging
    and parameters are those of nonlinear_state_space, with derivatives through the Runge-Kutta steps. The observer,
    with the gain K of a Kalman predictor, also estimates the first state from the last samples.
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
    """Candidates of one order: the ``linear`` space, and ``networks``, one of each mixture, after a short training.

    ``found`` is the lowest criterion of these networks on long simulations from history.
    """

    linear: Trained
    networks: Trained
    found: float


def best_networks(trained: Trained, problem: EstimationProblem, count: int) -> Trained:
    """Return the ``count`` networks whose criterion is lowest, the best first."""
    return trained[np.argsort(criterion(trained.error, trained.spaces, problem))[:count]]


def from_history(trained: Trained, problem: EstimationProblem) -> float:
    """Return the lowest criterion of networks on long simulations that start from the observer's estimate."""
    if trained.starts.shape[1] != len(problem.long):  # the training was on short simulations
        trained = replace(trained, starts=problem.states(trained, problem.short)[:, problem.long.begins])
    return float(criterion(problem.assessed(trained)[1], trained.spaces, problem).min())


def criterion(errors: Array, spaces: StateSpaceBatch, problem: EstimationProblem) -> Array:
    """Return the Bayesian information criterion (S,) for each sample: log ``errors`` (S,) + P log(N) / N."""
    count = sum(part.outputs.size for part in problem.parts)
    known = np.where(np.isfinite(errors), np.maximum(errors, 1e-12), 1e6)
    return np.asarray(np.log(known) + (~spaces.blind).sum(axis=1) * np.log(count) / count)


def members_of(
    trained: list[Trained], problem: EstimationProblem
) -> tuple[list[StateSpaceBatch], list[StateObserver], Array]:
    """Return each space of these trainings as a batch of one, its observer, and the criteria (S,)."""
    assessed = [problem.assessed(own) for own in trained]
    spaces = [own.spaces[[s]] for own in trained for s in range(len(own.spaces))]
    observers = [one for found, _ in assessed for one in found]
    scores = [criterion(errors, own.spaces, problem) for own, (_, errors) in zip(trained, assessed, strict=True)]
    return spaces, observers, np.concatenate(scores)


def with_whole_orders(diverged: BoolArray, orders: IntArray) -> BoolArray:
    """Return ``diverged`` (S,) with all members of an order of which at least half diverge, if any members remain.

    The recording does not determine the states of such an order, and members that have not diverged yet may do so under
    other controls. ``orders`` (S,) are the numbers of states of the members.
    """
    shares = np.array([diverged[orders == order].mean() for order in orders])
    whole = diverged | (shares >= UNDETERMINED)
    return diverged if whole.all() else whole


def mean_weights(found: Array, diverged: BoolArray, most: int) -> Array:
    """Return the weights (S,) of members in the mean, with sum 1, from their criteria ``found`` (S,).

    At most ``most`` members have a weight above 0. Members that have ``diverged`` (S,) have none, unless all have.
    """
    eligible = np.where(diverged & ~diverged.all(), np.inf, found)
    weights = np.exp(-SHARPNESS * (eligible - eligible.min()))
    weights[np.argsort(eligible, kind="stable")[most:]] = 0.0
    weights[weights <= NEGLIGIBLE] = 0.0
    return np.asarray(weights / weights.sum())


SPREAD = 0.7
"""Standard deviation of the initial weights into the units."""
CONTROL_UNIT_FACTOR = 2.0
"""Factor of that deviation for units of the controls only, which have few inputs."""


def networks(
    linear: StateSpaceBatch, mixtures: list[Mixture], hidden: int, rng: np.random.Generator
) -> StateSpaceBatch:
    """Return one space for each mixture that steps like the ``linear`` one, with units of zero weight."""
    return widened(linear[[0] * len(mixtures)], mixtures, hidden, rng)


def widened(
    spaces: StateSpaceBatch, mixtures: list[Mixture], further: int, rng: np.random.Generator
) -> StateSpaceBatch:
    """Return spaces that step like these, with ``further`` units of zero weight for each of the mixtures."""
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
                inner[s, h] *= np.where(np.arange(seen) < n, 0.0, CONTROL_UNIT_FACTOR)
    return _appended(spaces, inner, kinds)


def padded(spaces: StateSpaceBatch, further: int) -> StateSpaceBatch:
    """Return the same spaces with ``further`` units without effect, to be combined with wider ones."""
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
