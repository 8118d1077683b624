"""Families sindy and sindy_discrete; the continuation of a differential equation outside the data."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from model_zoo.features import between_limits, integrals
from model_zoo.polynomial.model import Regression
from model_zoo.polynomial.regression import SparsePolynomial
from sysid_evo import Dataset, register_model
from sysid_evo.models.dynamics import rk4
from sysid_evo.models.kernels import Predictor, runge_kutta_predictor, turning_frame
from sysid_evo.models.learned import Declared, Numbers
from sysid_evo.types import Array, BoolArray, IntArray


@register_model("sindy")
class Sindy(SparsePolynomial):
    """Differential equation with few, readable polynomial terms (SINDy), found by sparse regression with pysindy.

    dx/dt = Theta(x, u) Xi + w(x), Theta all monomials up to ``degree`` (Brunton, Proctor, Kutz 2016); w is the rotation
    of a planar body's frame, (r v, -r u, 0), else zero. The derivative is the difference over one step, taken at the
    mean of its two ends and the control held (second order in dt). Sequentially thresholded least squares drops
    coefficients below ``threshold`` (of quantities divided by their RMS) with the L2 penalty ``ridge``.
    Settings left at None are chosen by the simulation error over one second on held-out blocks of time: the fewest
    terms within 5 % of the best. docs/models.md describes ``functions``, ``library`` and ``optimizer``.

    A step is one fourth-order Runge-Kutta step with held controls; inputs are clipped to the training range. Outside
    this range the equation is bounded (`continued`), so that a polynomial which grows there cannot diverge. Integrals
    are not bounded.
    """

    knowledge = "dark grey"
    requires = ("pysindy",)
    has_weak_form = True

    def regression(self, dataset: Dataset, lags: tuple[int, int]) -> Regression:
        system = dataset.system
        data = dataset.transitions(state_lags=lags[0], control_lags=lags[1], moving=True)
        middle = 0.5 * (data.state + data.after)
        rate = (data.after - data.state) / system.dt - system.frame_rotation(middle)
        carry = np.concatenate([middle, data.carry[:, system.nx :]], axis=1)
        features = self.features_of(system, lags)
        seen, measured = features(carry, data.control), features(data.carry, data.control)
        found = Regression(seen, rate, measured, data.state, integrals(dataset), self.sampled(dataset, lags))
        return found[np.flatnonzero(between_limits(system, data.after))]

    def set_learned(self, data: Regression, coefficients: Array, exponents: IntArray) -> None:
        super().set_learned(data, coefficients, exponents)
        self.continuation_ = continuation_limits(data.states, data.targets, data.added)

    def zero_of(self, added: Array | BoolArray) -> Array:
        return np.zeros(len(added))  # rates have no offset

    def learned_arrays(self) -> Mapping[str, Declared]:
        return {"continuation_": Numbers(5, self.system.nx, infinite=True)}

    def left_sides(self) -> list[tuple[str, str]]:
        return [(f"acceleration of {c.name}", f"{c.unit or '1'}/s") for c in self.system.states]

    def predictor(self) -> Predictor | None:
        rate = turning_frame(self.right_side(), self.system, bounds=self.continuation_)
        return None if rate is None else runge_kutta_predictor(rate, self.system, n_carry=self.n_carry)

    def next_state(self, carry: Array, control: Array) -> Array:
        system = self.system
        held = carry[:, system.nx :]

        def rate(state: Array) -> Array:
            learned = self.polynomial(np.concatenate([state, held], axis=1), control)
            return continued(learned, system.frame_rotation(state), state, self.continuation_, system.dt)

        return rk4(rate, carry[:, : system.nx], system.dt)


@register_model("sindy_discrete")
class SindyDiscrete(SparsePolynomial):
    """Difference equation with few, readable polynomial terms (discrete-time SINDy), found with pysindy.

    x_{k+1} = Theta(x_k, u_k) Xi, Theta all monomials up to ``degree`` (Brunton, Proctor, Kutz 2016). Sequentially
    thresholded least squares drops coefficients below ``threshold`` (of quantities divided by their RMS) with the L2
    penalty ``ridge``; inputs are clipped to the training range. The other settings, and their choice if left at None,
    are those of sindy. Of an integral the change is predicted (`integrals`).
    """

    requires = ("pysindy",)
    knowledge = "black"
    lag_options: ClassVar[tuple[tuple[int, int], ...]] = ((0, 0), (0, 2), (0, 3), (1, 3))
    few_lags: ClassVar[tuple[tuple[int, int], ...]] = ((0, 0), (0, 3), (1, 3))


MARGIN = 0.1
"""Width of the margin outside the range of a state in which outward rates fade to zero, as a share of the range."""


def continuation_limits(states: Array, rates: Array, endless: BoolArray) -> Array:
    """Return the bounds of the continuation (5, nx): lowest and highest state, 1 / margin, lowest and highest rate.

    ``states`` and ``rates`` (N, nx) are the training data; an ``endless`` (nx,) state, such as a position, has no
    bounds.
    """
    low, high = states.min(axis=0), states.max(axis=0)
    width = np.where(high > low, high - low, 1.0)
    found = np.stack([low, high, 1.0 / (MARGIN * width), rates.min(axis=0), rates.max(axis=0)])
    free = np.array([[-np.inf], [np.inf], [1.0], [-np.inf], [np.inf]])
    return np.where(endless, free, found)


def continued(rate: Array, turning: Array, state: Array, bounds: Array, dt: float) -> Array:
    """Return dx/dt (B, nx) of a learned ``rate`` and the known ``turning`` of the frame.

    The rate is clipped to that of the data. Above the range of a state, rates upwards fade to zero over a tenth of the
    range and the excess decays with the time constant dt; likewise below. Beyond the margin every state therefore
    returns, for any polynomial, and no state exceeds the margin by more than one step of bounded rates.
    """
    low, high, per_margin, slowest, fastest = bounds
    total = np.clip(rate, slowest, fastest) + turning
    above, below = np.maximum(state - high, 0.0), np.maximum(low - state, 0.0)
    up = np.maximum(total, 0.0) * np.maximum(1.0 - above * per_margin, 0.0)
    down = np.minimum(total, 0.0) * np.maximum(1.0 - below * per_margin, 0.0)
    return up + down - (above - below) / dt
