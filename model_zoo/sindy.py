"""Sparse identification of a differential equation (SINDy with control), fitted by pysindy."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from model_zoo.channels.integrals import between_limits, integrals
from model_zoo.flows.runge_kutta import rk4
from model_zoo.sparse.continuation import continued, limits
from model_zoo.sparse.family import Regression
from model_zoo.sparse.regression import SparsePolynomial
from sysid_evo import Dataset, register_model
from sysid_evo.arrays import Array, IntArray

if TYPE_CHECKING:
    from sysid_evo.engine.kernels import Predictor


@register_model("sindy")
class Sindy(SparsePolynomial):
    """dx/dt = Theta(x, u) Xi + w(x), Theta all monomials up to ``degree`` (Brunton, Proctor, Kutz 2016).

    w is the rotation of a planar body's frame, (r v, -r u, 0); without one it is zero. The derivative
    is the difference over one step, the state the mean of its two ends, the control the one held:
    correct to second order in dt. Sequentially thresholded least squares drops coefficients below
    ``threshold`` (of quantities divided by their RMS) and shrinks by ``ridge``; what is left open is chosen by
    free runs, as `SparsePolynomial` says, which also tells of periodic states and of ``functions``. Stepped with the
    fourth-order Runge-Kutta method, controls held; inputs are clipped to the training range. Outside it the equation
    goes on bounded, see `continued`: a polynomial that pushes outwards there cannot run away. Integrals run on.
    """

    has_weak_form = True
    presets: ClassVar[dict[str, dict[str, Any]]] = {"quick": {"lag_search": "few"}}

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
