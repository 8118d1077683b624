"""Training of differential equations whose right-hand side holds a network: torchdiffeq's RK4 at the data's dt."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torchdiffeq import odeint

from model_zoo.networks.multistep import Plan, as_network, forward_pass, single
from model_zoo.networks.network import Network
from model_zoo.networks.standardised import StandardisedModel
from model_zoo.networks.trainings import Trainings
from model_zoo.validation.held_out import time_blocks
from sysid_evo.arrays import Array
from sysid_evo.data import Dataset

FOLDS = 5
Physics = Callable[[Tensor, Tensor, Tensor], Tensor]
"""(state (..., nx), control (..., nu), positive parameters (n,)) -> rate (..., nx)."""


class Flow(StandardisedModel):
    """dx/dt = network(x, lagged samples, control) + physics + rotation of the frame, controls held.

    Of the ``physical`` parameters (n,), all positive, the logarithms are trained, beside the network's.
    """

    physics: Physics | None = None

    def know(self, physics: Physics, physical: Array) -> None:
        """Add ``physics``, with parameters that begin at ``physical``."""
        self.physics = physics
        self.parameters.append(single(np.log(physical)[None, None]).requires_grad_(True))

    def step(self, carry: Tensor, control: Tensor) -> Tensor:
        nx = self.system.nx
        held = carry[..., nx:]
        network = self.parameters if self.physics is None else self.parameters[:-1]

        def rate(_: Tensor, state: Tensor) -> Tensor:
            seen = self.inputs(torch.cat([state, held], dim=2), control)
            result = forward_pass(network, seen) * self.rates
            if self.physics is not None:
                result = result + self.physics(state, control, torch.exp(self.parameters[-1][0, 0]))
            return self.motion.turned(state, result)

        times = torch.tensor([0.0, self.system.dt])
        after = odeint(rate, carry[..., :nx], times, method="rk4", options={"perturb": False})[-1]
        return self.moved(carry, control, after)


@dataclass(frozen=True)
class FittedFlow:
    """The network of features of (carry, control) to rates, the physical parameters, and the validation error."""

    network: Network
    physical: Array
    error: float


def train_flow(
    dataset: Dataset,
    lags: tuple[int, int],
    *,
    hidden: Sequence[int],
    plan: Plan,
    trainings: Trainings,
    physics: Physics | None,
    physical: Array,
) -> FittedFlow:
    """Train one flow on all but the held-out blocks of time, and keep what simulates those best."""
    model = Flow(dataset, lags, hidden=hidden, rng=trainings.rng)
    n_network = len(model.parameters)
    if physics is not None:
        model.know(physics, physical)
    best, errors = model.learn([time_blocks(dataset, 0, FOLDS)], plan, trainings)
    network = as_network(best[:n_network]).folded(model.centre, model.scale, model.standard.change / dataset.system.dt)
    logarithms = [array.detach().numpy().astype(np.float64).ravel() for array in best[n_network:]]
    return FittedFlow(network, np.exp(np.concatenate([np.empty(0), *logarithms])), float(errors[0]))
