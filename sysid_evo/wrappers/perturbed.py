"""A dynamics that answers to commands otherwise than its model, differently in every trial."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.dynamics import Dynamics, PlainDynamics
from sysid_evo.errors import InvalidArgument

if TYPE_CHECKING:
    from sysid_evo.kernels import DynamicsKernel
    from sysid_evo.wrappers.radical_envelope import RadicalEnvelope

NEVER = -1e6
"""A threshold below which no standard normal number lies."""


class Perturbed(PlainDynamics):
    """``inner`` = f with commands that come late or not at all, and with another strength and speed of answer.

    With the state x and command u measured from neutral, and factors g, s (nx,), e (nu,) of the trial::

        x_{k+1} = s (y + g (f(y, v) - y)) + m z_k,        y = x_k / s,        v = e r_{k-d}

    r_k is the last command that was not lost, d the latency and p the probability of loss in the trial; m the size
    of the process noise; ``noise`` says how they are drawn, sizes are in ``spread`` (nx,). The model so sees its own
    state y, and a robot with s = 1.1 does everything 10 % more. The carry is that of ``inner`` (with x for
    y), then g, s, m, e, d, the threshold of loss, and the last commands received (newest first).
    """

    def __init__(self, inner: Dynamics, noise: RadicalEnvelope, spread: Array) -> None:
        if inner.observed_at != 0:
            raise InvalidArgument("noise: the dynamics is observed late already; perturb it first")
        system = inner.system
        self.inner, self.noise = inner, noise
        self.system, self.doubt_at = system, inner.doubt_at
        self.free_states, self.free_controls = noise.free(system)
        self.steady = self.free_states.copy()
        self.steady[list(system.periods)] = 0.0
        self.size = noise.process * self.free_states * spread
        self.stored = max(noise.latency, 1 if noise.dropout else 0)
        self.n_own = 3 * system.nx + system.nu + 2
        self.n_carry = inner.n_carry + self.n_own + self.stored * system.nu
        self.n_lags = max(inner.n_lags, self.stored)
        self.process_at = inner.n_noise if noise.process else -1
        self.dropout_at = inner.n_noise + (system.nx if noise.process else 0) if noise.dropout else -1
        self.n_noise = inner.n_noise + (system.nx if noise.process else 0) + (1 if noise.dropout else 0)
        self.n_draws = inner.n_draws + self.n_own

    @property
    def envelope(self) -> Array | None:
        return self.inner.envelope

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        from scipy.special import ndtr, ndtri

        nx, nu, lags = self.system.nx, self.system.nu, self.inner.n_lags
        draws = np.zeros((len(states), self.n_draws)) if draws is None else draws
        z = draws[:, self.inner.n_draws :]
        gain = np.exp(self.noise.gain * self.steady * z[:, :nx])
        scale = np.exp(self.noise.scale * self.steady * z[:, nx : 2 * nx])
        process = self.size * ndtr(z[:, 2 * nx : 3 * nx])
        effect = np.exp(self.noise.effect * self.free_controls * z[:, 3 * nx : 3 * nx + nu])
        level = ndtr(z[:, -2:])
        delay = np.minimum(np.floor(level[:, :1] * (self.noise.latency + 1)), self.noise.latency)
        with np.errstate(divide="ignore"):
            threshold = np.maximum(ndtri(self.noise.dropout * level[:, 1:]), NEVER)
        rest = self.system.neutral_state
        own = rest + (states[:, states.shape[1] - 1 - lags :] - rest) / scale[:, None]
        inner = self.inner.start(own, controls[:, controls.shape[1] - lags :], draws[:, : self.inner.n_draws])
        past = [controls[:, controls.shape[1] - 1 - back] for back in range(self.stored)]
        return np.concatenate(
            [states[:, -1], inner[:, nx:], gain, scale, process, effect, delay, threshold, *past], axis=1
        )

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        nx, nu, at = self.system.nx, self.system.nu, self.inner.n_carry
        own, past = carry[:, at : at + self.n_own], carry[:, at + self.n_own :]
        gain, scale, process = own[:, :nx], own[:, nx : 2 * nx], own[:, 2 * nx : 3 * nx]
        effect, delay, threshold = own[:, 3 * nx : 3 * nx + nu], own[:, -2:-1], own[:, -1:]
        received = control
        if self.dropout_at >= 0:
            assert noise is not None
            lost = noise[:, self.dropout_at : self.dropout_at + 1] < threshold
            received = np.where(lost & (self.free_controls > 0), past[:, :nu], control)
        applied = received
        for back in range(1, self.noise.latency + 1):
            late = (delay == back) & (self.free_controls > 0)
            applied = np.where(late, past[:, (back - 1) * nu : back * nu], applied)
        idle, rest = self.system.neutral_control, self.system.neutral_state
        applied = idle + effect * (applied - idle)
        before = rest + (carry[:, :nx] - rest) / scale
        given = noise[:, : self.inner.n_noise] if noise is not None and self.inner.n_noise else None
        inner = self.inner.step(np.concatenate([before, carry[:, nx:at]], axis=1), applied, given)
        after = rest + scale * (before + gain * (inner[:, :nx] - before) - rest)
        if self.process_at >= 0:
            assert noise is not None
            after = after + process * noise[:, self.process_at : self.process_at + nx]
        kept = np.concatenate([received, past], axis=1)[:, : self.stored * nu]
        return np.concatenate([after, inner[:, nx:], own, kept], axis=1)

    def kernel(self) -> DynamicsKernel | None:
        inner = self.inner.kernel()
        if inner is None:
            return None
        from sysid_evo.engine.kernels.noise import perturbed_kernel

        return perturbed_kernel(
            inner,
            self.system,
            self.inner.n_carry,
            free_controls=self.free_controls,
            latency=self.noise.latency,
            stored=self.stored,
            process_at=self.process_at,
            dropout_at=self.dropout_at,
        )
