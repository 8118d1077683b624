"""Sparse identification of a differential equation (SINDy with control), fitted by pysindy."""

from __future__ import annotations

from typing import Any, ClassVar

from model_zoo.sparse.flow import ContinuousSparse
from sysid_evo import register_model


@register_model("sindy")
class Sindy(ContinuousSparse):
    """dx/dt = Theta(x, u) Xi + w(x), Theta all monomials up to ``degree`` (Brunton, Proctor, Kutz 2016).

    w is the rotation of a planar body's frame, (r v, -r u, 0); without one it is zero. The derivative
    is the difference over one step, the state the mean of its two ends, the control the one held:
    correct to second order in dt. Sequentially thresholded least squares drops coefficients below
    ``threshold`` (of quantities divided by their RMS) and shrinks by ``ridge``; what is left open is chosen by
    free runs, as `SparsePolynomial` says, which also tells of periodic states and of ``functions``. Stepped with the
    fourth-order Runge-Kutta method, controls held; inputs are clipped to the training range.
    """

    has_weak_form = True
    presets: ClassVar[dict[str, dict[str, Any]]] = {"quick": {"lag_search": "few"}}
