"""A model that counts how far others disagree with it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from sysid_evo.arrays import Array, check_shape
from sysid_evo.data.support import QUANTILE, split_pairs
from sysid_evo.dynamics import Dynamics, PlainDynamics
from sysid_evo.errors import InvalidArgument
from sysid_evo.wrappers.members import Members

if TYPE_CHECKING:
    from sysid_evo.kernels import DynamicsKernel


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
        from sysid_evo.engine.kernels.several import cautious_kernel

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
