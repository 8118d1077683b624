"""Several dynamics that take turns: another one in each trial, or now and then within it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.dynamics import Dynamics, PlainDynamics
from sysid_evo.errors import InvalidArgument
from sysid_evo.wrappers.members import Members

if TYPE_CHECKING:
    from sysid_evo.engine.compiled.kernel import DynamicsKernel


class Switching(PlainDynamics):
    """One of several ``models`` of a system, drawn for every trial.

    With ``every``, another is drawn within the trial too, after so many samples on average. All models step at
    every sample from the same state, so that one that takes over knows the past; the state is that of
    the model whose turn it is. A step costs what the steps of all together cost. The carry is the state, the number
    of the model, and the carry of each. ``pairs_`` are those of the first, see `DynamicsModel`.
    """

    def __init__(self, models: Sequence[Dynamics], every: float | None = None) -> None:
        if every is not None and not 1.0 <= every < np.inf:
            raise InvalidArgument(f"switching: expected every >= 1 sample, got {every}")
        self.members = Members(models)
        self.every = every
        self.system, self.n_lags = self.members.system, self.members.n_lags
        self.n_carry = self.system.nx + 1 + self.members.n_carry
        self.n_noise = self.members.n_noise + (0 if every is None else 2)
        self.n_draws = self.members.n_draws + 1
        self.pairs_: Array | None = getattr(models[0], "pairs_", None)

    @property
    def envelope(self) -> Array | None:
        return self.members.envelope

    @property
    def bounds(self) -> Array:
        """The standard normal numbers (M - 1,) that divide the line into as many equally probable parts as models."""
        from scipy.special import ndtri

        count = len(self.members)
        return np.asarray(ndtri(np.arange(1, count) / count), dtype=np.float64)

    @property
    def change(self) -> float:
        """The standard normal number below which the model changes."""
        from scipy.special import ndtri

        assert self.every is not None
        return float(np.minimum(ndtri(1.0 / self.every), 1e6))

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        draws = np.zeros((len(states), self.n_draws)) if draws is None else draws
        members = self.members.start(states, controls, draws[:, :-1])
        return np.concatenate([states[:, -1], self._drawn(draws[:, -1])[:, None], members], axis=1)

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        nx = self.system.nx
        which = carry[:, nx]
        if self.every is not None:
            assert noise is not None
            change, drawn = noise[:, -2], self._drawn(noise[:, -1])
            which = np.where(change < self.change, drawn, which)
        predicted, rests = self.members.step(carry[:, :nx], carry[:, nx + 1 :], control, noise)
        after = predicted[which.astype(np.int64), np.arange(len(carry))]
        return np.concatenate([after, which[:, None], self.members.joined(after, rests)], axis=1)

    def kernel(self) -> DynamicsKernel | None:
        kernels = [model.kernel() for model in self.members.models]
        if any(kernel is None for kernel in kernels):
            return None
        from sysid_evo.engine.kernels.several import switching_kernel

        return switching_kernel(
            [kernel for kernel in kernels if kernel is not None],
            self.system.nx,
            places=[self.system.nx + 1 + place for place in self.members.places],
            noise_places=self.members.noise_places,
            n_noise=self.members.n_noise,
            bounds=self.bounds,
            change=None if self.every is None else self.change,
        )

    def _drawn(self, z: Array) -> Array:
        """Return the number of the model (B,) that standard normal numbers (B,) stand for."""
        return (z[:, None] > self.bounds).sum(axis=1).astype(np.float64)
