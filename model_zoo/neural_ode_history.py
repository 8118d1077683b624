"""A neural ordinary differential equation that also sees earlier samples."""

from __future__ import annotations

from model_zoo.flows.network_rate import NetworkRate
from sysid_evo import register_model


@register_model("neural_ode_history")
class NeuralOdeHistory(NetworkRate):
    """dx/dt = network(x, u, earlier controls and states) + w(x), w the rotation of a planar body's frame.

    Trained through the steps of a fixed-step fourth-order Runge-Kutta method on windows of
    ``horizon`` steps, each from a measured state (multiple shooting), as `NetworkRate` says.
    Earlier samples are held over a step; how many is chosen by the simulation error on held-out
    blocks of time unless given.
    """
