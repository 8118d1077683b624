"""Uncertainty penalty: steps outside the data, disagreement of models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sysid_evo.data.support import QUANTILE, Support, split_pairs
from sysid_evo.errors import InvalidArgument
from sysid_evo.kernels import DynamicsKernel
from sysid_evo.models.base import DynamicsModel
from sysid_evo.models.dynamics import Dynamics, PlainDynamics
from sysid_evo.models.ensemble import Members
from sysid_evo.models.kernels.penalty import penalised_kernel
from sysid_evo.registry.registry import penalties
from sysid_evo.types import Array, check_shape


@penalties.register("uncertainty")
@dataclass(frozen=True)
class UncertaintyPenalty:
    """Fitness penalty for steps where a model is unreliable (fitness units per trial; 0 disables it).

    ``outside``: penalty of a trial that is entirely outside the training data; ``disagreement``: of one in which the
    models disagree in every step. A trial is penalised in proportion to the affected steps, see `Penalised`; it
    continues, so that leaving the data for a moment costs little. As in MOPO and MOReL.
    """

    outside: float = 0.0
    disagreement: float = 0.0

    def __post_init__(self) -> None:
        for name in ("outside", "disagreement"):
            value = getattr(self, name)
            if not isinstance(value, (int, float)) or isinstance(value, bool) or not 0 <= value < np.inf:
                raise InvalidArgument(f"penalty: expected {name} to be a number >= 0, got {value!r}")

    @property
    def maximum(self) -> float:
        """The largest penalty of a trial."""
        return self.outside + self.disagreement

    def around(self, dynamics: Dynamics, others: Sequence[Dynamics] = ()) -> Dynamics:
        """Return ``dynamics`` with this penalty; robots are returned unchanged.

        ``others`` are further members of the ensemble; those that are not models are ignored. Raises `InvalidArgument`
        for a model without a training sample.
        """
        if getattr(dynamics, "training_sample_", None) is None:
            if isinstance(dynamics, DynamicsModel):
                raise InvalidArgument(
                    f"penalty: {type(dynamics).__name__} was stored without a sample of its training data: fit it again"
                )
            return dynamics
        against = [other for other in others if getattr(other, "training_sample_", None) is not None]
        wanted = self if against else UncertaintyPenalty(self.outside)
        return Penalised(dynamics, wanted, against) if wanted.maximum else dynamics


CHECKED_EVERY = 10
"""Steps between two comparisons with the training data."""


class Penalised(PlainDynamics):
    """``model`` with an uncertainty penalty that accumulates in its carry.

    *Outside*: every ``every``-th step is compared with the training data and represents the others: 0 within the limit
    of `Support`, the full weight beyond twice the limit, linear in between. By default ``support`` is made from the
    ``training_sample_`` of the model.

    *Disagreement*: all models step from the state of ``model``. For each state the largest difference between two
    models is divided by its ``limit`` (nx,); the largest of these ratios counts: 0 up to 1, the full weight from 2 on,
    linear in between. By default the limit is the 99 % quantile of the difference over the ``training_sample_``;
    errors on held-out data are another choice. A step costs as much as the steps of all models.

    The carry is that of ``model``, those of the ``others``, the penalty, and the steps to the next comparison.
    """

    def __init__(
        self,
        model: Dynamics,
        penalty: UncertaintyPenalty,
        others: Sequence[Dynamics] = (),
        *,
        support: Support | None = None,
        limit: Array | None = None,
        every: int = CHECKED_EVERY,
    ) -> None:
        if every < 1:
            raise InvalidArgument(f"penalty: expected every >= 1 step, got {every}")
        if penalty.disagreement and not others:
            raise InvalidArgument("penalty: expected at least one other model, got none")
        self.penalty, self.every = penalty, every
        self.members = Members([model, *others] if penalty.disagreement else [model])
        self.system, self.n_lags = self.members.system, self.members.n_lags
        self.n_noise, self.n_draws = self.members.n_noise, self.members.n_draws
        self.penalty_at = self.members.n_carry
        self.n_carry = self.penalty_at + 2
        self.training_sample_: Array | None = getattr(model, "training_sample_", None)
        self.support: Support | None = None
        if penalty.outside:
            data = Support.of(self.system, *self._recorded()) if support is None else support
            smallest = float(np.finfo(np.float32).tiny)  # the limit is 0 if all recorded pairs are equal
            self.support = replace(data, limit=max(data.limit, smallest))
        self.limit = np.ones(self.system.nx)
        if penalty.disagreement:
            found = self._usual() if limit is None else check_shape("limit", limit, (self.system.nx,))
            self.limit = np.maximum(found, 1e-6)

    @property
    def state_bounds(self) -> Array | None:
        return self.members.models[0].state_bounds

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        draws = np.zeros((len(states), self.n_draws)) if draws is None else draws
        return np.concatenate([self.members.start(states, controls, draws), np.zeros((len(states), 2))], axis=1)

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        state, members, (penalty, clock) = (
            carry[:, : self.system.nx],
            carry[:, : self.penalty_at],
            carry[:, self.penalty_at :].T,
        )
        outside = np.zeros(len(carry))
        if self.support is not None:
            due = clock == 0.0
            if due.any():
                beyond = self.support.distances(state[due], control[due]) / self.support.limit - 1.0
                outside[due] = self.penalty.outside * self.every * np.clip(beyond, 0.0, 1.0)
            clock = np.where(due, self.every, clock) - 1.0
        predicted, rests = self.members.step(state, members, control, noise)
        if self.penalty.disagreement:
            beyond = (np.ptp(predicted, axis=0) / self.limit).max(axis=1) - 1.0
            penalty = penalty + self.penalty.disagreement * np.clip(beyond, 0.0, 1.0)
        return np.concatenate(
            [self.members.joined(predicted[0], rests), np.stack([penalty + outside, clock], axis=1)], axis=1
        )

    def kernel(self) -> DynamicsKernel | None:
        return self._compiled

    @cached_property
    def _compiled(self) -> DynamicsKernel | None:
        kernels = [kernel for model in self.members.models if (kernel := model.kernel()) is not None]
        if len(kernels) < len(self.members.models) or (self.support is not None and self.system.periods):
            return None
        return penalised_kernel(
            kernels,
            (self.system.nx, self.system.nu),
            self.members.places,
            self.members.noise_places,
            penalty_at=self.members.n_carry,
            outside=self.penalty.outside,
            support=self.support,
            every=self.every,
            disagreement=self.penalty.disagreement,
            limit=self.limit,
        )

    def _usual(self) -> Array:
        """Return the difference (nx,) that the models exceed in 1 % of the training data, after a constant history."""
        states, controls = self._recorded()
        past = np.repeat(states[:, None], self.n_lags + 1, axis=1)
        commands = np.repeat(controls[:, None], self.n_lags, axis=1)
        carries = self.members.start(past, commands, np.zeros((len(states), self.n_draws)))
        with np.errstate(all="ignore"):
            predicted, _ = self.members.step(states, carries, controls, np.zeros((len(states), self.n_noise)))
        return np.asarray(np.quantile(np.ptp(predicted, axis=0), QUANTILE, axis=0), dtype=np.float64)

    def _recorded(self) -> tuple[Array, Array]:
        """Return states (N, nx) and controls (N, nu) of the training data."""
        if self.training_sample_ is None:
            raise InvalidArgument(
                "penalty: the model has no sample of its training data; give support= for `outside`, limit= for "
                "`disagreement`"
            )
        return split_pairs(self.system, self.training_sample_)
