"""Training of differential equations whose right-hand side holds a network: torchdiffeq's RK4 at the data's dt."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torchdiffeq import odeint

from model_zoo.channels.standard import Standard
from model_zoo.networks.multistep import (
    Plan,
    Report,
    Shots,
    as_network,
    as_tensors,
    forward_pass,
    judged,
    moved,
    single,
    train,
)
from model_zoo.networks.network import Network, random_network
from model_zoo.validation.held_out import time_blocks
from sysid_evo.arrays import Array
from sysid_evo.data import Dataset
from sysid_evo.free_run import judging_windows
from sysid_evo.lags import CarryLayout
from sysid_evo.motion.torch_form import TorchMotion, torch_motion
from sysid_evo.system import System

Physics = Callable[[Tensor, Tensor, Tensor], Tensor]
"""(state (..., nx), control (..., nu), parameters (n,)) -> rate (..., nx)."""


@dataclass
class Flow:
    """dx/dt = network(x, lagged samples, control) + physics + rotation of the frame, controls held."""

    system: System
    motion: TorchMotion
    layout: CarryLayout
    centre: Tensor
    scale: Tensor
    rate_scale: Tensor
    parameters: list[Tensor]
    n_network: int
    physics: Physics | None

    def step(self, carry: Tensor, control: Tensor) -> Tensor:
        nx = self.system.nx
        held = torch.cat([carry[..., nx:], control], dim=2)

        def rate(_: Tensor, state: Tensor) -> Tensor:
            inputs = (torch.cat([state, held], dim=2) - self.centre) / self.scale
            result = forward_pass(self.parameters[: self.n_network], inputs) * self.rate_scale
            if self.physics is not None:
                result = result + self.physics(state, control, self.parameters[-1])
            return self.motion.turned(state, result)

        times = torch.tensor([0.0, self.system.dt])
        after = odeint(rate, carry[..., :nx], times, method="rk4", options={"perturb": False})[-1]
        return moved(self.layout, carry, control, after)


@dataclass(frozen=True)
class FittedFlow:
    """The network of raw (carry, control) to rates, the physical parameters, and the validation error."""

    network: Network
    physical: Array
    error: float


def train_flow(
    dataset: Dataset,
    lags: tuple[int, int],
    *,
    hidden: tuple[int, ...],
    plan: Plan,
    rng: np.random.Generator,
    physics: Physics | None = None,
    physical: Array | None = None,
    report: Report | None = None,
) -> FittedFlow:
    """Train one flow on all but the held-out blocks of time, and keep what simulates those best."""
    system, history = dataset.system, max(lags)
    standard = Standard.of(dataset)
    layout = CarryLayout(system.nx, system.nu, *lags)
    centre, scale = standard.of_inputs(layout)
    parameters = as_tensors(random_network([len(centre), *hidden, system.nx], 1, rng))
    n_network = len(parameters)
    if physical is not None:
        parameters.append(single(physical[None, None]).requires_grad_(True))
    rates = standard.change / system.dt
    model = Flow(
        system,
        torch_motion(system),
        layout,
        single(centre),
        single(scale),
        single(rates),
        parameters,
        n_network,
        physics,
    )
    learned, held = time_blocks(dataset, 0, 5)
    windows = [Shots.from_windows(judging_windows(held, history))]
    state_scale = single(standard.state_scale)

    def judge(candidate: list[Tensor]) -> Array:
        return judged(model, candidate, windows, state_scale)

    best = train(
        model,
        [Shots.of(learned, plan.horizon, history)],
        plan,
        state_scale=state_scale,
        change_scale=single(standard.change),
        rng=rng,
        judge=judge,
        report=report,
    )
    network = as_network(best[:n_network]).folded(centre, scale, rates)
    last = np.zeros(0) if physical is None else best[-1].detach().numpy().astype(np.float64).ravel()
    return FittedFlow(network, last, float(judge(best)[0]))
