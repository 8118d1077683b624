"""A dynamics whose state is known a little late, as an estimator that must not look ahead knows it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.dynamics import Dynamics, PlainDynamics
from sysid_evo.errors import InvalidArgument

if TYPE_CHECKING:
    from sysid_evo.kernels import DynamicsKernel

WHOLE_TOLERANCE = 1e-9
"""A delay this near to a whole number of samples is one."""


class DelayedEstimate(PlainDynamics):
    """``inner``, of which controllers and tasks observe the state of ``delay`` s ago.

    With delay / dt = m + f, m whole and 0 <= f < 1, what is observed at sample k lies between two
    samples::

        o_k = (1 - f) x_{k-m} + f x_{k-m-1}

    The carry is that of ``inner``, then o_k, then the last m states (newest first). The state itself,
    the pose that a task makes of it, walls and the envelope are those of ``inner``: only what is
    observed is late. On the robot too the pose comes from the tracker and only velocities are estimated.
    """

    def __init__(self, inner: Dynamics, delay: float) -> None:
        if not 0.0 <= delay < math.inf:
            raise InvalidArgument(f"delayed estimate: expected a delay >= 0 s, got {delay}")
        if inner.observed_at != 0:
            raise InvalidArgument("delayed estimate: the dynamics has an estimate of its own already")
        samples = delay / inner.system.dt
        self.inner = inner
        self.delay = delay
        self.whole = math.floor(samples + WHOLE_TOLERANCE)
        self.share = max(0.0, samples - self.whole)
        self.system = inner.system
        self.observed_at = inner.n_carry
        self.n_carry = inner.n_carry + self.system.nx * (1 + self.whole)
        self.n_lags = max(inner.n_lags, self.whole + 1)
        self.n_noise = inner.n_noise
        self.n_draws = inner.n_draws
        self.doubt_at = inner.doubt_at

    @property
    def envelope(self) -> Array | None:
        return self.inner.envelope

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        lags, m = self.inner.n_lags, self.whole
        inner = self.inner.start(
            states[:, states.shape[1] - 1 - lags :], controls[:, controls.shape[1] - lags :], draws
        )
        observed = self._between(states[:, -1 - m], states[:, -2 - m])
        past = [states[:, -2 - lag] for lag in range(m)]
        return np.concatenate([inner, observed, *past], axis=1)

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        nx, at, m = self.system.nx, self.observed_at, self.whole
        inner = self.inner.step(carry[:, :at], control, noise)
        newest = inner[:, :nx]
        if self.envelope is not None:
            newest = np.clip(newest, *self.envelope)
        states = np.concatenate([newest, carry[:, :nx], carry[:, at + nx :]], axis=1)
        observed = self._between(states[:, m * nx :][:, :nx], states[:, (m + 1) * nx :][:, :nx])
        return np.concatenate([inner, observed, states[:, nx : (m + 1) * nx]], axis=1)

    def kernel(self) -> DynamicsKernel | None:
        inner = self.inner.kernel()
        if inner is None:
            return None
        from sysid_evo.engine.kernels.delay import delayed_kernel

        return delayed_kernel(
            inner, self.system.nx, self.inner.n_carry, whole=self.whole, share=self.share, envelope=self.envelope
        )

    def _between(self, later: Array, earlier: Array) -> Array:
        return (1.0 - self.share) * later + self.share * earlier
