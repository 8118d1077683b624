"""A neural ordinary differential equation of state and control."""

from __future__ import annotations

from typing import Any, ClassVar

from model_zoo.flows.network_rate import NetworkRate
from sysid_evo.registry import register_model


@register_model("neural_ode")
class NeuralOde(NetworkRate):
    """dx/dt = network(x, u) + w(x), w the rotation of a planar body's frame (Chen et al. 2018).

    Trained through the steps of a fixed-step fourth-order Runge-Kutta method on windows of
    ``horizon`` steps, each from a measured state (multiple shooting), as `NetworkRate` says.
    """

    presets: ClassVar[dict[str, dict[str, Any]]] = {
        "quick": {"hidden": [24], "one_step_updates": 500, "updates": 150, "horizon": 10},
        "paper": {"one_step_updates": 3000, "updates": 1500},
    }
