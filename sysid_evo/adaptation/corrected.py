"""A dynamics whose accelerations are corrected by coefficients that stand in its carry, others for each row."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sysid_evo.adaptation.terms import Terms
from sysid_evo.arrays import Array
from sysid_evo.dynamics.stepping import Dynamics, PlainDynamics

if TYPE_CHECKING:
    from sysid_evo.engine.compiled.kernel import DynamicsKernel


class Corrected(PlainDynamics):
    """``inner`` with ``terms`` added to its accelerations; their coefficients are the end of the carry, at first 0.

    `told` puts others there; a step leaves them as they are.
    """

    def __init__(self, inner: Dynamics, terms: Terms) -> None:
        self.inner, self.terms, self.system = inner, terms, inner.system
        self.n_lags, self.n_noise, self.n_draws = inner.n_lags, inner.n_noise, inner.n_draws
        self.observed_at, self.doubt_at = inner.observed_at, inner.doubt_at
        self.n_coefficients = terms.size * inner.system.nx
        self.n_carry = inner.n_carry + self.n_coefficients

    @property
    def envelope(self) -> Array | None:
        return self.inner.envelope

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        begun = self.inner.start(states, controls, draws)
        return np.concatenate([begun, np.zeros((len(begun), self.n_coefficients))], axis=1)

    def told(self, carry: Array, coefficients: Array) -> Array:
        """Return ``carry`` (B, n_carry) with these coefficients, (B, size, nx) or (size, nx) for all."""
        rows = np.broadcast_to(coefficients, (len(carry), *self.terms.shape)).reshape(len(carry), -1)
        return np.concatenate([carry[:, : self.inner.n_carry], rows], axis=1)

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        nx, n_inner = self.system.nx, self.inner.n_carry
        after = self.inner.step(carry[:, :n_inner], control, noise)
        coefficients = carry[:, n_inner:].reshape(-1, *self.terms.shape)
        moved = self.terms.corrected(carry[:, :nx], control, after[:, :nx], coefficients)
        return np.concatenate([moved, after[:, nx:], carry[:, n_inner:]], axis=1)

    def kernel(self) -> DynamicsKernel | None:
        inner = self.inner.kernel()
        if inner is None:
            return None
        from sysid_evo.engine.kernels.correction import correction_kernel

        return correction_kernel(inner, self.terms, None, carried_at=self.inner.n_carry)
