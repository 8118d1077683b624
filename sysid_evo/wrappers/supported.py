"""A model that counts how often it is asked where it has no data."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.data.support import Support, split_pairs
from sysid_evo.dynamics import Dynamics, PlainDynamics
from sysid_evo.errors import InvalidArgument

if TYPE_CHECKING:
    from sysid_evo.kernels import DynamicsKernel

CHECKED_EVERY = 10
"""Steps from one look to the next."""


class Supported(PlainDynamics):
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

    @property
    def envelope(self) -> Array | None:
        return self.inner.envelope

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
        from sysid_evo.engine.kernels.support import supported_kernel

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
