"""Uncertainty penalty: steps outside the data, disagreement of models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sysid_evo.data.support import QUANTILE, Support, split_pairs
from sysid_evo.errors import InvalidArgument
from sysid_evo.kernels import DynamicsKernel
from sysid_evo.models.base import DynamicsModel
from sysid_evo.models.dynamics import Around, Dynamics, PlainDynamics
from sysid_evo.models.ensemble import Members
from sysid_evo.models.kernels.ensemble import cautious_kernel
from sysid_evo.models.kernels.support import supported_kernel
from sysid_evo.registry.registry import cautions
from sysid_evo.types import Array, check_shape


@cautions.register("doubt")
@dataclass(frozen=True)
class Doubt:
    """What a trial loses where its model cannot be believed, in units of fitness; 0 means nothing (as in MOPO, MOReL).

    ``outside``: of a trial that is outside the training data from beginning to end (`Supported`);
    ``disagreement``: of one in which the models disagree all the time (`Cautious`). What lies between costs its
    share of the steps. A trial goes on: one that leaves the data for a moment and comes back loses little.
    """

    outside: float = 0.0
    disagreement: float = 0.0

    def __post_init__(self) -> None:
        for name in ("outside", "disagreement"):
            value = getattr(self, name)
            if not isinstance(value, (int, float)) or isinstance(value, bool) or not 0 <= value < np.inf:
                raise InvalidArgument(f"caution: expected {name} to be a number >= 0, got {value!r}")

    @property
    def most(self) -> float:
        """What a trial loses at most."""
        return self.outside + self.disagreement

    def about(self, dynamics: Dynamics, others: Sequence[Dynamics] = ()) -> Dynamics:
        """Return ``dynamics`` with the doubt counted; a robot is not doubted.

        The ``others`` are further models of the ensemble; what is no model is left out. Raises `InvalidArgument` for
        a model that does not know its training data.
        """
        if getattr(dynamics, "pairs_", None) is None:
            if isinstance(dynamics, DynamicsModel):
                raise InvalidArgument(
                    f"caution: {type(dynamics).__name__} was stored without states of its training data: fit it again"
                )
            return dynamics
        inner = dynamics
        against = [other for other in others if getattr(other, "pairs_", None) is not None]
        if self.disagreement and against:
            inner = Cautious(inner, against, weight=self.disagreement)
        return Supported(inner, weight=self.outside) if self.outside else inner


class Cautious(PlainDynamics):
    """``model``, which counts as doubt how far it and the ``others`` disagree about the next state.

    All step from the same state; the state is that of ``model``. Disagreement is the largest difference between
    two of them in a state, divided by its ``limit`` (nx,), and the largest of these counts: 0 up to 1, ``weight``
    from 2 on, in proportion between. By default the limit is the 99 % quantile of the difference over the
    ``pairs_`` of the training data; errors on held-out data can be given instead. The carry is the state, the
    doubt, and the carry of each. A step costs what the steps of all together cost.
    """

    def __init__(
        self, model: Dynamics, others: Sequence[Dynamics], *, limit: Array | None = None, weight: float = 1.0
    ) -> None:
        if not others:
            raise InvalidArgument("caution: expected at least one other model, got none")
        self.members = Members([model, *others])
        self.weight = weight
        self.system, self.n_lags = self.members.system, self.members.n_lags
        self.doubt_at = self.system.nx
        self.n_carry = self.system.nx + 1 + self.members.n_carry
        self.n_noise, self.n_draws = self.members.n_noise, self.members.n_draws
        self.pairs_: Array | None = getattr(model, "pairs_", None)
        found = self._usual() if limit is None else check_shape("limit", limit, (self.system.nx,))
        self.limit = np.maximum(found, 1e-6)

    @property
    def envelope(self) -> Array | None:
        return self.members.models[0].envelope

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        draws = np.zeros((len(states), self.n_draws)) if draws is None else draws
        members = self.members.start(states, controls, draws)
        return np.concatenate([states[:, -1], np.zeros((len(states), 1)), members], axis=1)

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        nx = self.system.nx
        predicted, rests = self.members.step(carry[:, :nx], carry[:, nx + 1 :], control, noise)
        beyond = (np.ptp(predicted, axis=0) / self.limit).max(axis=1) - 1.0
        doubt = carry[:, nx] + self.weight * np.clip(beyond, 0.0, 1.0)
        return np.concatenate([predicted[0], doubt[:, None], self.members.joined(predicted[0], rests)], axis=1)

    def kernel(self) -> DynamicsKernel | None:
        kernels = [model.kernel() for model in self.members.models]
        if any(kernel is None for kernel in kernels):
            return None
        return cautious_kernel(
            [kernel for kernel in kernels if kernel is not None],
            self.system.nx,
            places=[self.system.nx + 1 + place for place in self.members.places],
            noise_places=self.members.noise_places,
            limit=self.limit,
            weight=self.weight,
        )

    def _usual(self) -> Array:
        """Return the difference (nx,) that the models exceed in 1 % of the training data, after a steady past."""
        if self.pairs_ is None:
            raise InvalidArgument("caution: the model does not know its training data; give the limit")
        states, controls = split_pairs(self.system, self.pairs_)
        past = np.repeat(states[:, None], self.n_lags + 1, axis=1)
        commands = np.repeat(controls[:, None], self.n_lags, axis=1)
        carries = self.members.start(past, commands, np.zeros((len(states), self.n_draws)))
        with np.errstate(all="ignore"):
            predicted, _ = self.members.step(states, carries, controls, np.zeros((len(states), self.n_noise)))
        return np.asarray(np.quantile(np.ptp(predicted, axis=0), QUANTILE, axis=0), dtype=np.float64)


CHECKED_EVERY = 10
"""Steps from one look to the next."""


class Supported(Around):
    """``inner``, which counts as doubt the steps whose state and control lie outside the training data.

    Looked at is every ``every``-th step, which counts for all of them: 0 within the limit of `Support`, ``weight``
    from twice the limit on, in proportion between. ``support`` is made of the ``pairs_`` of ``inner`` if it is not
    given. The carry is that of ``inner``, then the doubt (unless ``inner`` counts some already, to which
    this is added), then the steps to the next look.
    """

    def __init__(
        self, inner: Dynamics, support: Support | None = None, *, weight: float = 1.0, every: int = CHECKED_EVERY
    ) -> None:
        if every < 1:
            raise InvalidArgument(f"support: expected every >= 1 step, got {every}")
        self.inner, self.weight, self.every = inner, weight, every
        self.system, self.n_lags, self.n_noise, self.n_draws = inner.system, inner.n_lags, inner.n_noise, inner.n_draws
        self.observed_at = inner.observed_at
        self.doubt_at = inner.n_carry if inner.doubt_at is None else inner.doubt_at
        self.clock_at = inner.n_carry + (1 if inner.doubt_at is None else 0)
        self.n_carry = self.clock_at + 1
        self.pairs_: Array | None = getattr(inner, "pairs_", None)
        if support is None:
            if self.pairs_ is None:
                raise InvalidArgument("support: the dynamics does not know its training data; give a Support")
            support = Support.of(self.system, *split_pairs(self.system, self.pairs_))
        self.support = support
        self.limit = max(support.limit, float(np.finfo(np.float32).tiny))

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        inner = self.inner.start(states, controls, draws)
        return np.concatenate([inner, np.zeros((len(inner), self.n_carry - inner.shape[1]))], axis=1)

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        clock = carry[:, self.clock_at]
        due = clock == 0.0
        doubt = np.zeros(len(carry))
        if due.any():
            beyond = self.support.distances(carry[due, : self.system.nx], control[due]) / self.limit - 1.0
            doubt[due] = self.weight * self.every * np.clip(beyond, 0.0, 1.0)
        inner = self.inner.step(carry[:, : self.inner.n_carry], control, noise)
        after = np.concatenate([inner, carry[:, self.inner.n_carry :]], axis=1)
        after[:, self.doubt_at] += doubt
        after[:, self.clock_at] = np.where(due, self.every, clock) - 1.0
        return after

    def kernel(self) -> DynamicsKernel | None:
        return self._compiled

    @cached_property
    def _compiled(self) -> DynamicsKernel | None:
        inner = self.inner.kernel()
        if inner is None or self.system.periods:
            return None
        assert self.doubt_at is not None
        return supported_kernel(
            inner,
            self.support,
            doubt_at=self.doubt_at,
            clock_at=self.clock_at,
            weight=self.weight,
            every=self.every,
            limit=self.limit,
        )
