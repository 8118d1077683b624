"""Sparse identification of a map from step to step, fitted by pysindy."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

from model_zoo.sparse.polynomial import left_sides
from model_zoo.sparse.regression import Regression, SparsePolynomial
from sysid_evo.arrays import Array
from sysid_evo.data import Dataset
from sysid_evo.registry import register_model

if TYPE_CHECKING:
    from sysid_evo.engine.compiled.kernel import DynamicsKernel


@register_model("sindy_discrete")
class SindyDiscrete(SparsePolynomial):
    """x_{k+1} = Theta(x_k, u_k) Xi with all monomials up to ``degree`` (Brunton, Proctor, Kutz 2016).

    Sequentially thresholded least squares drops coefficients below ``threshold`` (of quantities
    divided by their RMS) and shrinks by ``ridge``; inputs are clipped to the training range. What is left
    open is chosen by free runs, as `SparsePolynomial` says. Of a periodic state the change is predicted.
    """

    knowledge = "black"
    presets: ClassVar[dict[str, dict[str, Any]]] = {"quick": {"degree": 2, "control_lags": 0, "state_lags": 0}}

    offered_lags: ClassVar[tuple[tuple[int, int], ...]] = ((0, 0), (0, 2), (0, 3), (1, 3))

    def regression(self, dataset: Dataset, lags: tuple[int, int]) -> Regression:
        data = dataset.transitions(state_lags=lags[0], control_lags=lags[1], moving=True)
        features = self.features_of(dataset.system, lags)
        seen = features(data.carry, data.control)
        return Regression(seen, data.after - features.anchor(data.state), seen, data.state)

    def left_sides(self) -> list[tuple[str, str]]:
        return left_sides(self.system)

    def kernel(self) -> DynamicsKernel | None:
        from sysid_evo.engine.kernels import stepping_kernel

        polynomial = self.predictor()
        if polynomial is None:
            return None
        return stepping_kernel(polynomial, self.system, output="next_state", lags=self.lags, rest_band=self.rest_band)

    def next_state(self, carry: Array, control: Array) -> Array:
        return self.features.anchor(carry[:, : self.system.nx]) + self.polynomial(carry, control)
