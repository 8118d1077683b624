"""Networks of standardised features as a differentiable model, trained on all but held-out blocks of time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from model_zoo.channels.features import Features
from model_zoo.channels.mirror import Mirror
from model_zoo.channels.standard import Standard
from model_zoo.networks.multistep import Plan, Shots, TorchModel, as_tensors, judged, single, train
from model_zoo.networks.network import random_network
from model_zoo.networks.trainings import Trainings
from sysid_evo.arrays import Array
from sysid_evo.data import Dataset
from sysid_evo.free_run import judging_windows
from sysid_evo.lags import CarryLayout
from sysid_evo.motion.torch_form import torch_motion


class StandardisedModel(TorchModel):
    """``members`` random networks with ``further`` inputs beside `Features`, and what standardises these.

    The last layer gives nx numbers in units of ``change``, each state's RMS change in one step, or of ``rates``,
    that per second.
    """

    def __init__(
        self,
        dataset: Dataset,
        lags: tuple[int, int],
        *,
        hidden: Sequence[int],
        rng: np.random.Generator,
        members: int = 1,
        further: int = 0,
        mirror: Mirror | None = None,
    ) -> None:
        self.system = dataset.system
        self.motion = torch_motion(self.system)
        self.features = Features(self.system, lags)
        self.layout = CarryLayout(self.system.nx, self.system.nu, *lags)
        self.standard = Standard.of(dataset, mirror)
        self.centre, self.scale = self.standard.of_inputs(self.layout)
        self._centre, self._scale = single(self.centre), single(self.scale)
        self.change, self.rates = single(self.standard.change), single(self.standard.change / self.system.dt)
        sizes = [len(self.centre) + further, *hidden, self.system.nx]
        self.parameters = as_tensors(random_network(sizes, members, rng))

    def inputs(self, carry: Tensor, control: Tensor) -> Tensor:
        """Return the features of (carry, control), standardised."""
        seen = torch.cat(self.features.parts(carry, control, torch.sin, torch.cos), dim=2)
        return (seen - self._centre) / self._scale

    def moved(self, carry: Tensor, control: Tensor, after: Tensor) -> Tensor:
        """Return the carry whose newest state is ``after``."""
        return torch.cat(self.layout.moved(carry, control, after), dim=-1)

    def learn(
        self,
        splits: Sequence[tuple[Dataset, Dataset]],
        plan: Plan,
        trainings: Trainings,
    ) -> tuple[list[Tensor], Array]:
        """Train each member on the first part of its split.

        Returns the parameters with which it simulates the second part best, and its error there (M,).
        """
        history, state_scale = self.layout.history, single(self.standard.state_scale)
        held = [Shots.from_windows(judging_windows(part, history)) for _, part in splits]

        def judge(parameters: list[Tensor]) -> Array:
            return judged(self, parameters, held, state_scale)

        learned = train(
            self,
            [Shots.of(part, plan.horizon, history) for part, _ in splits],
            plan,
            state_scale=state_scale,
            change_scale=self.change,
            trainings=trainings,
            judge=judge,
        )
        return learned, judge(learned)
