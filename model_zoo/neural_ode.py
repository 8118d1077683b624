"""A neural ordinary differential equation of state and control."""

from __future__ import annotations

from typing import Any, ClassVar

from model_zoo.flows.network_rate import QUICK, NetworkRate
from sysid_evo import register_model


@register_model("neural_ode")
class NeuralOde(NetworkRate):
    """dx/dt = network(x, u) + w(x), w the rotation of a planar body's frame (Chen et al. 2018).

    Trained through the steps of a fixed-step fourth-order Runge-Kutta method on windows of
    ``horizon`` steps, each from a measured state (multiple shooting), as `NetworkRate` says.
    """

    offered_lags: ClassVar[tuple[tuple[int, int], ...]] = ((0, 0),)
    presets: ClassVar[dict[str, dict[str, Any]]] = {**NetworkRate.presets, "quick": QUICK}
