"""A sparse polynomial as a differential equation, in the body's own frame."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from model_zoo.channels.integrals import between_limits, integrals
from model_zoo.flows.runge_kutta import rk4
from model_zoo.sparse.continuation import continued, limits
from model_zoo.sparse.family import Regression
from model_zoo.sparse.regression import SparsePolynomial
from sysid_evo.arrays import Array, IntArray
from sysid_evo.data import Dataset

if TYPE_CHECKING:
    from sysid_evo.engine.kernels import Predictor


class ContinuousSparse(SparsePolynomial):
    """A sparse differential equation: what `Sindy` and its bagged form share.

    Outside the training range it goes on bounded, see `continued`: a polynomial that pushes outwards there cannot run
    away. Integrals run on.
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
        self.continuation_ = limits(data.states, data.targets, data.added)

    def left_sides(self) -> list[tuple[str, str]]:
        return [(f"acceleration of {c.name}", f"{c.unit or '1'}/s") for c in self.system.states]

    def predictor(self) -> Predictor | None:
        from sysid_evo.engine.kernels import runge_kutta_predictor, turning_frame

        polynomial = self.right_side()
        if polynomial is None:
            return None
        rate = turning_frame(polynomial, self.system, bounds=self.continuation_)
        return None if rate is None else runge_kutta_predictor(rate, self.system, n_carry=self.n_carry)

    def next_state(self, carry: Array, control: Array) -> Array:
        system = self.system
        held = carry[:, system.nx :]

        def rate(state: Array) -> Array:
            learned = self.polynomial(np.concatenate([state, held], axis=1), control)
            return continued(learned, system.turning(state), state, self.continuation_, system.dt)

        return rk4(rate, carry[:, : system.nx], system.dt)
