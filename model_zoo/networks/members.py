"""Networks of lagged states and controls as one differentiable model, member beside member."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from model_zoo.channels.mirror import Mirror
from model_zoo.networks.multistep import Plan, as_network, forward_pass, single
from model_zoo.networks.network import Network
from model_zoo.networks.standardised import StandardisedModel
from model_zoo.networks.trainings import Trainings
from model_zoo.validation.held_out import time_blocks
from sysid_evo.arrays import Array
from sysid_evo.data import Dataset

RECORDED = torch.ones(1, 1, 1)


class LaggedMembers(StandardisedModel):
    """M networks of (carry, control, flag) that give the change of the state in one step.

    ``flag`` (M, B, 1) is 1 for data as recorded and -1 for mirrored data.
    """

    def __init__(
        self,
        dataset: Dataset,
        lags: tuple[int, int],
        *,
        hidden: Sequence[int],
        members: int,
        mirror: Mirror | None,
        rng: np.random.Generator,
    ) -> None:
        super().__init__(dataset, lags, hidden=hidden, rng=rng, members=members, further=1, mirror=mirror)
        self.mirror = mirror
        self.noise = torch.Generator().manual_seed(int(rng.integers(2**31)))
        self.generators = (self.noise,)
        self.flag = RECORDED

    def step(self, carry: Tensor, control: Tensor) -> Tensor:
        inputs = self.inputs(carry, control)
        inputs = torch.cat([inputs, self.flag.expand(*inputs.shape[:2], 1)], dim=2)
        change = forward_pass(self.parameters, inputs) * self.change
        return self.moved(carry, control, self.motion.integrate(carry[..., : self.system.nx], change, self.system.dt))

    def augmented(self, batch: list[Tensor]) -> list[Tensor]:
        """Mirror half of the windows (past states, past controls, controls, states), if the body has a mirror."""
        if self.mirror is None:
            return batch
        states, controls = single(self.mirror.states), single(self.mirror.controls)
        mirrored = (torch.rand(*batch[0].shape[:2], 1, 1, generator=self.noise) < 0.5).float()
        self.flag = 1.0 - 2.0 * mirrored[:, :, 0]
        signs = (states, controls, controls, states)
        return [part * (1.0 - mirrored + mirrored * sign) for part, sign in zip(batch, signs, strict=True)]

    def as_recorded(self) -> None:
        self.flag = RECORDED


def train_members(
    dataset: Dataset,
    lags: tuple[int, int],
    *,
    hidden: tuple[int, ...],
    members: int,
    folds: int,
    plan: Plan,
    mirror: Mirror | None,
    trainings: Trainings,
) -> tuple[Network, Array]:
    """Train ``members`` networks, each on the blocks of time that are left when its own are held out.

    Returns networks of features of (carry, control) that give accelerations, and each member's validation error (M,).
    """
    model = LaggedMembers(dataset, lags, hidden=hidden, members=members, mirror=mirror, rng=trainings.rng)
    splits = [time_blocks(dataset, member, folds) for member in range(members)]
    parameters, errors = model.learn(splits, plan, trainings)
    flagged = as_network(parameters)
    weights, biases = list(flagged.weights), list(flagged.biases)
    biases[0] = biases[0] + weights[0][:, -1]
    weights[0] = weights[0][:, :-1]
    accelerations = model.standard.change / dataset.system.dt
    return Network(weights, biases).folded(model.centre, model.scale, accelerations), errors
