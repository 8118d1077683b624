"""Sparse identification of a map from step to step, fitted by pysindy."""

from __future__ import annotations

from typing import Any, ClassVar

from model_zoo.sparse.regression import SparsePolynomial
from sysid_evo import register_model


@register_model("sindy_discrete")
class SindyDiscrete(SparsePolynomial):
    """x_{k+1} = Theta(x_k, u_k) Xi with all monomials up to ``degree`` (Brunton, Proctor, Kutz 2016).

    Sequentially thresholded least squares drops coefficients below ``threshold`` (of quantities
    divided by their RMS) and shrinks by ``ridge``; inputs are clipped to the training range. What is left
    open is chosen by free runs, as `SparsePolynomial` says. Of an integral the change is predicted, see `integrals`.
    """

    knowledge = "black"
    presets: ClassVar[dict[str, dict[str, Any]]] = {"quick": {"lag_search": "few"}}

    offered_lags: ClassVar[tuple[tuple[int, int], ...]] = ((0, 0), (0, 2), (0, 3), (1, 3))
    few_lags: ClassVar[tuple[tuple[int, int], ...]] = ((0, 0), (0, 3), (1, 3))
