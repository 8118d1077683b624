"""A neural ordinary differential equation that also sees earlier samples."""

from __future__ import annotations

from typing import Any, ClassVar

from model_zoo.flows.network_rate import NetworkRate
from sysid_evo.registry import register_model


@register_model("neural_ode_history")
class NeuralOdeHistory(NetworkRate):
    """dx/dt = network(x, u, earlier controls and states) + w(x), w the rotation of a planar body's frame.

    Trained through the steps of a fixed-step fourth-order Runge-Kutta method on windows of
    ``horizon`` steps, each from a measured state (multiple shooting), as `NetworkRate` says.
    Earlier samples are held over a step; how many is chosen by the simulation error on held-out
    blocks of time unless given.
    """

    offered_lags: ClassVar[tuple[tuple[int, int], ...]] = ((0, 2), (0, 3), (1, 3))
    presets: ClassVar[dict[str, dict[str, Any]]] = {
        "quick": {
            "hidden": [24],
            "one_step_updates": 500,
            "updates": 150,
            "horizon": 10,
            "control_lags": 2,
            "state_lags": 0,
        },
        "paper": {"one_step_updates": 3000, "updates": 1500},
    }
