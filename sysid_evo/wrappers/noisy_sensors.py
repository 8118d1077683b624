"""A dynamics whose state is observed with noise."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.dynamics import Dynamics, PlainDynamics

if TYPE_CHECKING:
    from sysid_evo.kernels import DynamicsKernel
    from sysid_evo.wrappers.radical_envelope import RadicalEnvelope


class NoisySensors(PlainDynamics):
    """``inner``, of which controllers and tasks observe the state with a bias and white noise.

    ``noise`` says how much, in ``spread`` (nx,). What is observed at sample k of what ``inner`` shows, o_k,
    with z standard normal::

        o_k + b + m z_k,        b = bias spread z,        m = sensor spread U,        U in [0, 1]

    b and m stay for a trial. The carry is that of ``inner``, then what is observed, then b, then m. The state
    itself, the pose that a task makes of it, and walls are those of ``inner``: on the robot too the
    tracker sees the pose, and velocities come out of it with noise. The first sample has the bias only.
    """

    def __init__(self, inner: Dynamics, noise: RadicalEnvelope, spread: Array) -> None:
        nx = inner.system.nx
        self.inner, self.noise = inner, noise
        self.system, self.n_lags, self.doubt_at = inner.system, inner.n_lags, inner.doubt_at
        self.size = noise.free(inner.system)[0] * spread
        self.observed_at = inner.n_carry
        self.n_carry = inner.n_carry + 3 * nx
        self.n_noise = inner.n_noise + nx
        self.n_draws = inner.n_draws + 2 * nx

    @property
    def envelope(self) -> Array | None:
        return self.inner.envelope

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        from scipy.special import ndtr

        draws = np.zeros((len(states), self.n_draws)) if draws is None else draws
        inner = self.inner.start(states, controls, draws[:, : self.inner.n_draws])
        bias, level = np.split(draws[:, self.inner.n_draws :], 2, axis=1)
        bias, level = self.noise.bias * self.size * bias, self.noise.sensor * self.size * ndtr(level)
        return np.concatenate([inner, self._shown(inner) + bias, bias, level], axis=1)

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        assert noise is not None
        at, own = self.inner.n_carry, self.inner.n_noise
        inner = self.inner.step(carry[:, :at], control, noise[:, :own] if own else None)
        _, bias, level = np.split(carry[:, at:], 3, axis=1)
        return np.concatenate([inner, self._shown(inner) + bias + level * noise[:, own:], bias, level], axis=1)

    def kernel(self) -> DynamicsKernel | None:
        inner = self.inner.kernel()
        if inner is None:
            return None
        from sysid_evo.engine.kernels.noise import sensors_kernel

        return sensors_kernel(
            inner,
            self.system.nx,
            self.inner.n_carry,
            shown_at=self.inner.observed_at,
            n_noise=self.inner.n_noise,
            envelope=self.envelope,
        )

    def _shown(self, inner: Array) -> Array:
        """Return what ``inner`` shows of its state, (B, nx), within the envelope as a loop will clip it."""
        at, nx = self.inner.observed_at, self.system.nx
        shown = inner[:, at : at + nx]
        return shown if self.envelope is None else np.clip(shown, *self.envelope)
