"""Sparse identification of a map from step to step, fitted by pysindy."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from model_zoo.sparse.regression import Regression, SparsePolynomial
from model_zoo.stepwise import lagged_steps
from sysid_evo.arrays import Array
from sysid_evo.data import Dataset
from sysid_evo.registry import register_model

if TYPE_CHECKING:
    from sysid_evo.engine.compiled.kernel import DynamicsKernel


@register_model("sindy_discrete")
class SindyDiscrete(SparsePolynomial):
    """x_{k+1} = Theta(x_k, u_k) Xi with all monomials up to ``degree`` (Brunton, Proctor, Kutz 2016).

    Sequentially thresholded least squares drops coefficients below ``threshold`` (of quantities
    divided by their RMS) and shrinks by ``ridge``; inputs are clipped to the training range.
    """

    knowledge = "black"
    presets: ClassVar[dict[str, dict[str, Any]]] = {"quick": {"degree": 2, "control_lags": 0, "state_lags": 0}}

    def __init__(
        self,
        *,
        degree: int | None = None,
        threshold: float | None = None,
        ridge: float = 1e-3,
        state_lags: int | None = None,
        control_lags: int | None = None,
        rest_hold: bool = False,
    ) -> None:
        self.degree = degree
        self.threshold = threshold
        self.ridge = ridge
        self.state_lags = state_lags
        self.control_lags = control_lags
        self.rest_hold = rest_hold

    def regression(self, dataset: Dataset, lags: tuple[int, int]) -> Regression:
        carry, control, after = lagged_steps(dataset, lags)
        return Regression(np.concatenate([carry, control], axis=1), after)

    def left_sides(self) -> list[tuple[str, str]]:
        return [(f"{channel.name}[+1]", channel.unit) for channel in self.system.states]

    def kernel(self) -> DynamicsKernel:
        from sysid_evo.engine.kernels import stepping_kernel

        return stepping_kernel(
            self.predictor(), self.system, output="next_state", lags=self.lags, rest_band=self.rest_band
        )

    def next_state(self, carry: Array, control: Array) -> Array:
        return self.polynomial(np.concatenate([carry, control], axis=1))
