"""A neural ordinary differential equation of state and control."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from model_zoo.flows.network_rate import NetworkRate
from sysid_evo.data import Dataset
from sysid_evo.registry import register_model

if TYPE_CHECKING:
    from model_zoo.flows.training import FittedFlow
    from model_zoo.networks.multistep import Plan, Report


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

    def __init__(
        self,
        *,
        hidden: list[int] | None = None,
        state_lags: int | None = 0,
        control_lags: int | None = 0,
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
