"""Networks of lagged states and controls as one differentiable model, member beside member."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from model_zoo.channels.mirror import Mirror
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


@dataclass
class LaggedMembers:
    """M networks of (carry, control, flag) that give the change of the state in one step.

    ``flag`` (M, B, 1) is 1 for data as recorded and -1 for mirrored data.
    """

    system: System
    motion: TorchMotion
    layout: CarryLayout
    centre: Tensor
    scale: Tensor
    change: Tensor
    parameters: list[Tensor]
    mirror: Mirror | None
    noise: torch.Generator
    flag: Tensor

    def step(self, carry: Tensor, control: Tensor) -> Tensor:
        inputs = (torch.cat([carry, control], dim=2) - self.centre) / self.scale
        inputs = torch.cat([inputs, self.flag.expand(*inputs.shape[:2], 1)], dim=2)
        change = forward_pass(self.parameters, inputs) * self.change
        after = self.motion.integrate(carry[..., : self.system.nx], change, self.system.dt)
        return moved(self.layout, carry, control, after)

    def augment(self, batch: list[Tensor]) -> list[Tensor]:
        """Mirror half of the windows (past states, past controls, controls, states), if the body has a mirror."""
        if self.mirror is None:
            return batch
        states, controls = single(self.mirror.states), single(self.mirror.controls)
        mirrored = (torch.rand(*batch[0].shape[:2], 1, 1, generator=self.noise) < 0.5).float()
        self.flag = 1.0 - 2.0 * mirrored[:, :, 0]
        signs = (states, controls, controls, states)
        return [part * (1.0 - mirrored + mirrored * sign) for part, sign in zip(batch, signs, strict=True)]


@dataclass(frozen=True)
class Trained:
    """Networks of raw (carry, control) that give accelerations, and each member's validation error (M,)."""

    network: Network
    errors: Array


def train_members(
    dataset: Dataset,
    lags: tuple[int, int],
    *,
    hidden: tuple[int, ...],
    members: int,
    folds: int,
    plan: Plan,
    mirror: Mirror | None,
    rng: np.random.Generator,
    report: Report | None = None,
) -> Trained:
    """Train ``members`` networks, each on the blocks of time that are left when its own are held out."""
    system, history = dataset.system, max(lags)
    standard = Standard.of(dataset, mirror)
    layout = CarryLayout(system.nx, system.nu, *lags)
    centre, scale = standard.of_inputs(layout)
    n_inputs = len(centre) + 1
    start = random_network([n_inputs, *hidden, system.nx], members, rng)
    model = LaggedMembers(
        system,
        torch_motion(system),
        layout,
        single(centre),
        single(scale),
        single(standard.change),
        as_tensors(start),
        mirror,
        torch.Generator().manual_seed(int(rng.integers(2**31))),
        torch.ones(1, 1, 1),
    )
    splits = [time_blocks(dataset, member, folds) for member in range(members)]
    held = [Shots.from_windows(judging_windows(split[1], history)) for split in splits]
    state_scale = single(standard.state_scale)

    def judge(parameters: list[Tensor]) -> Array:
        model.flag = torch.ones(1, 1, 1)
        return judged(model, parameters, held, state_scale)

    shots = [Shots.of(split[0], plan.horizon, history) for split in splits]
    parameters = train(
        model,
        shots,
        plan,
        state_scale=state_scale,
        change_scale=single(standard.change),
        rng=rng,
        judge=judge,
        augment=model.augment,
        report=report,
    )
    errors = judge(parameters)
    flagged = as_network(parameters)
    weights, biases = list(flagged.weights), list(flagged.biases)
    biases[0] = biases[0] + weights[0][:, -1]
    weights[0] = weights[0][:, :-1]
    network = Network(weights, biases).folded(centre, scale, standard.change / system.dt)
    return Trained(network, errors)
