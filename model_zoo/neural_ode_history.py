"""A neural ordinary differential equation that also sees earlier samples."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from model_zoo.flows.network_rate import NetworkRate
from sysid_evo.data import Dataset
from sysid_evo.registry import register_model

if TYPE_CHECKING:
    from model_zoo.flows.training import FittedFlow
    from model_zoo.networks.multistep import Plan, Report


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

    def __init__(
        self,
        *,
        hidden: list[int] | None = None,
        state_lags: int | None = None,
        control_lags: int | None = None,
        one_step_updates: int = 1000,
        updates: int = 500,
        horizon: int = 20,
        learning_rate: float = 6e-3,
        rest_hold: bool = False,
    ) -> None:
        self.hidden = hidden
        self.state_lags = state_lags
        self.control_lags = control_lags
        self.one_step_updates = one_step_updates
        self.updates = updates
        self.horizon = horizon
        self.learning_rate = learning_rate
        self.rest_hold = rest_hold

    def train(
        self, dataset: Dataset, lags: tuple[int, int], plan: Plan, rng: np.random.Generator, report: Report
    ) -> FittedFlow:
        from model_zoo.flows.training import train_flow

        return train_flow(dataset, lags, hidden=tuple(self.hidden or (32, 32)), plan=plan, rng=rng, report=report)
