"""A sparse polynomial as a differential equation, in the body's own frame."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from model_zoo.channels.integrals import between_limits, integrals
from model_zoo.flows.runge_kutta import rk4
from model_zoo.sparse.family import Regression
from model_zoo.sparse.regression import SparsePolynomial
from sysid_evo.arrays import Array, IntArray
from sysid_evo.data import Dataset

if TYPE_CHECKING:
    from sysid_evo.engine.kernels import Predictor


class ContinuousSparse(SparsePolynomial):
    """A sparse differential equation: what `Sindy` and its bagged form share.

    What a state has beyond the training range decays with the time constant dt, so that a
    polynomial that pushes outwards there cannot run away. Integrals run on.
    """

    def regression(self, dataset: Dataset, lags: tuple[int, int]) -> Regression:
        system = dataset.system
        data = dataset.transitions(state_lags=lags[0], control_lags=lags[1], moving=True)
        middle = 0.5 * (data.state + data.after)
        rate = (data.after - data.state) / system.dt - system.turning(middle)
        carry = np.concatenate([middle, data.carry[:, system.nx :]], axis=1)
        features = self.features_of(system, lags)
        seen, measured = features(carry, data.control), features(data.carry, data.control)
        found = Regression(seen, rate, measured, data.state, integrals(dataset), self.sampled(dataset, lags))
        return found[np.flatnonzero(between_limits(system, data.after))]

    def adopt(self, data: Regression, coefficients: Array, exponents: IntArray) -> None:
        super().adopt(data, coefficients, exponents)
        seen = np.stack([data.states.min(axis=0), data.states.max(axis=0)])
        self.state_range_ = np.where(data.added, [[-np.inf], [np.inf]], seen)

    def left_sides(self) -> list[tuple[str, str]]:
        return [(f"acceleration of {c.name}", f"{c.unit or '1'}/s") for c in self.system.states]

    def predictor(self) -> Predictor | None:
        from sysid_evo.engine.kernels import runge_kutta_predictor, turning_frame

        polynomial = self.right_side()
        if polynomial is None:
            return None
        rate = turning_frame(polynomial, self.system, low=self.state_range_[0], high=self.state_range_[1])
        return None if rate is None else runge_kutta_predictor(rate, self.system, n_carry=self.n_carry)

    def next_state(self, carry: Array, control: Array) -> Array:
        system = self.system
        held = carry[:, system.nx :]

        def rate(state: Array) -> Array:
            outside = state - np.clip(state, *self.state_range_)
            known = system.turning(state) - outside / system.dt
            return self.polynomial(np.concatenate([state, held], axis=1), control) + known

        return rk4(rate, carry[:, : system.nx], system.dt)
