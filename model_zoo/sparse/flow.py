"""A sparse polynomial as a differential equation, in the body's own frame."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from model_zoo.flows.runge_kutta import rk4
from model_zoo.sparse.regression import Regression, SparsePolynomial
from model_zoo.stepwise import lagged_steps
from sysid_evo.arrays import Array
from sysid_evo.data import Dataset

if TYPE_CHECKING:
    from sysid_evo.engine.compiled.kernel import DynamicsKernel


class ContinuousSparse(SparsePolynomial):
    """A sparse differential equation: what `Sindy` and its bagged form share.

    What a state has beyond the training range decays with the time constant dt, so that a
    polynomial that pushes outwards there cannot run away.
    """

    def regression(self, dataset: Dataset, lags: tuple[int, int]) -> Regression:
        system = dataset.system
        carry, control, after = lagged_steps(dataset, lags)
        before = carry[:, : system.nx]
        middle = 0.5 * (before + after)
        rate = (after - before) / system.dt - system.turning(middle)
        return Regression(np.concatenate([middle, carry[:, system.nx :], control], axis=1), rate)

    def left_sides(self) -> list[tuple[str, str]]:
        return [(f"acceleration of {c.name}", f"{c.unit or '1'}/s") for c in self.system.states]

    def kernel(self) -> DynamicsKernel | None:
        from sysid_evo.engine.kernels import runge_kutta_predictor, stepping_kernel, turning_frame

        nx = self.system.nx
        rate = turning_frame(self.predictor(), self.system, low=self.low_[:nx], high=self.high_[:nx])
        if rate is None:
            return None
        step = runge_kutta_predictor(rate, self.system, n_carry=self.n_carry)
        return stepping_kernel(step, self.system, output="next_state", lags=self.lags, rest_band=self.rest_band)

    def next_state(self, carry: Array, control: Array) -> Array:
        system = self.system
        held = np.concatenate([carry[:, system.nx :], control], axis=1)

        def rate(state: Array) -> Array:
            outside = state - np.clip(state, self.low_[: system.nx], self.high_[: system.nx])
            known = system.turning(state) - outside / system.dt
            return self.polynomial(np.concatenate([state, held], axis=1)) + known

        return rk4(rate, carry[:, : system.nx], system.dt)
