"""Uncertainty penalty: steps outside the data."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sysid_evo.carry import recent
from sysid_evo.data.support import Support, split_pairs
from sysid_evo.errors import InvalidArgument
from sysid_evo.kernels import DynamicsKernel
from sysid_evo.models.base import DynamicsModel
from sysid_evo.models.dynamics import Dynamics, PlainDynamics
from sysid_evo.models.kernels.penalty import penalised_kernel
from sysid_evo.registry.registry import penalties
from sysid_evo.types import Array


@penalties.register("uncertainty")
@dataclass(frozen=True)
class UncertaintyPenalty:
    """Fitness penalty for steps where a model extrapolates (fitness units per trial; 0 disables it).

    ``outside`` is the penalty of a trial that is entirely outside the training data. A trial is penalised in proportion
    to the affected steps, see `Penalised`; it continues, so that leaving the data for a moment costs little (MOPO).
    """

    outside: float = 0.0

    def __post_init__(self) -> None:
        value = self.outside
        if not isinstance(value, (int, float)) or isinstance(value, bool) or not 0 <= value < np.inf:
            raise InvalidArgument(f"penalty: expected outside to be a number >= 0, got {value!r}")

    def around(self, dynamics: Dynamics) -> Dynamics:
        """Return ``dynamics`` with this penalty; robots are returned unchanged.

        Raises `InvalidArgument` for a model without a training sample.
        """
        if getattr(dynamics, "training_sample_", None) is None:
            if isinstance(dynamics, DynamicsModel):
                raise InvalidArgument(
                    f"penalty: {type(dynamics).__name__} was stored without a sample of its training data: fit it again"
                )
            return dynamics
        return Penalised(dynamics, self.outside) if self.outside else dynamics


CHECKED_EVERY = 10
"""Steps between two comparisons with the training data."""


class Penalised(PlainDynamics):
    """``model`` with an uncertainty penalty that accumulates in its carry.

    Every ``every``-th step is compared with the training data and represents the others: 0 within the limit of
    `Support`, the full weight ``outside`` beyond twice the limit, linear in between. By default ``support`` is made
    from the ``training_sample_`` of the model. The carry is that of ``model``, the penalty, and the steps to the next
    comparison.
    """

    def __init__(
        self, model: Dynamics, outside: float, *, support: Support | None = None, every: int = CHECKED_EVERY
    ) -> None:
        if every < 1:
            raise InvalidArgument(f"penalty: expected every >= 1 step, got {every}")
        if model.observed_at != 0:
            raise InvalidArgument("penalty: the model has delayed observations; delay the penalised one instead")
        self.model, self.outside, self.every = model, outside, every
        self.system, self.n_lags = model.system, model.n_lags
        self.n_noise, self.n_draws = model.n_noise, model.n_draws
        self.penalty_at = model.n_carry
        self.n_carry = self.penalty_at + 2
        self.training_sample_: Array | None = getattr(model, "training_sample_", None)
        data = self._recorded() if support is None else support
        smallest = float(np.finfo(np.float32).tiny)  # the limit is 0 if all recorded pairs are equal
        self.support = replace(data, limit=max(data.limit, smallest))

    @property
    def state_bounds(self) -> Array | None:
        return self.model.state_bounds

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        carry = self.model.start(*recent(states, controls, self.n_lags), draws)
        return np.concatenate([carry, np.zeros((len(states), 2))], axis=1)

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        state, inner = carry[:, : self.system.nx], carry[:, : self.penalty_at]
        penalty, clock = carry[:, self.penalty_at :].T.copy()
        due = clock == 0.0
        if due.any():
            beyond = self.support.distances(state[due], control[due]) / self.support.limit - 1.0
            penalty[due] += self.outside * self.every * np.clip(beyond, 0.0, 1.0)
        clock = np.where(due, self.every, clock) - 1.0
        after = self.model.step(inner, control, noise)
        return np.concatenate([after, np.stack([penalty, clock], axis=1)], axis=1)

    def kernel(self) -> DynamicsKernel | None:
        return self._compiled

    @cached_property
    def _compiled(self) -> DynamicsKernel | None:
        inner = self.model.kernel()
        if inner is None or self.system.periods:
            return None
        return penalised_kernel(
            inner, self.system.nu, penalty_at=self.model.n_carry, outside=self.outside, support=self.support,
            every=self.every,
        )  # fmt: skip

    def _recorded(self) -> Support:
        """Return the support of the training data."""
        if self.training_sample_ is None:
            raise InvalidArgument("penalty: the model has no sample of its training data; give support=")
        return Support.of(self.system, *split_pairs(self.system, self.training_sample_))
