"""The strongest peer a user would otherwise build: four one-step networks with lags in plain PyTorch."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.data import Dataset
from sysid_evo.dynamics import DynamicsModel
from sysid_evo.progress import Progress


class LaggedOneStepEnsemble(DynamicsModel):
    """The mean next state of four networks trained on single steps of lagged states and controls.

    Two tanh layers of 64 units, standardised inputs, the difference of the state as target, Adam
    with a falling rate, a little input noise: what peers.json calls "MLP one-step, lags".
    """

    def __init__(
        self, *, members: int = 4, state_lags: int = 1, control_lags: int = 3, epochs: int = 150, noise: float = 0.05
    ) -> None:
        self.members = members
        self.state_lags = state_lags
        self.control_lags = control_lags
        self.epochs = epochs
        self.noise = noise

    def fit(
        self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None
    ) -> LaggedOneStepEnsemble:
        import torch

        windows = dataset.windows(1, history=max(self.lags), moving=True)
        carry = self.lagged(windows.past_states, windows.past_controls)
        inputs = np.concatenate([carry, windows.controls[:, 0]], axis=1)
        change = windows.states[:, 0] - windows.start_states
        self.centre_, self.scale_ = inputs.mean(axis=0), inputs.std(axis=0)
        self.change_centre_, self.change_scale_ = change.mean(axis=0), change.std(axis=0)
        x = torch.from_numpy(((inputs - self.centre_) / self.scale_).astype(np.float32))
        y = torch.from_numpy(((change - self.change_centre_) / self.change_scale_).astype(np.float32))
        steps = max(1, len(x) // 128) * self.epochs
        layers: list[list[Array]] = []
        for member in range(self.members):
            draw = torch.Generator().manual_seed(int(rng.integers(2**31)))
            sizes = [x.shape[1], 64, 64, y.shape[1]]
            parameters = []
            for n_in, n_out in pairwise(sizes):
                parameters += [torch.randn(n_in, n_out, generator=draw) / n_in**0.5, torch.zeros(n_out)]
            for parameter in parameters:
                parameter.requires_grad_(True)
            optimiser = torch.optim.Adam(parameters, lr=3e-3)
            schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
            for _ in range(steps):
                rows = torch.randint(len(x), (128,), generator=draw)
                h = x[rows] + self.noise * torch.randn(128, x.shape[1], generator=draw)
                for layer in range(3):
                    h = h @ parameters[2 * layer] + parameters[2 * layer + 1]
                    h = torch.tanh(h) if layer < 2 else h
                loss = ((h - y[rows]) ** 2).mean()
                optimiser.zero_grad()
                loss.backward()
                optimiser.step()
                schedule.step()
            layers.append([parameter.detach().numpy().astype(np.float64) for parameter in parameters])
            if progress is not None:
                progress(member + 1, self.members)
        self.layers_ = layers
        return self

    def next_state(self, carry: Array, control: Array) -> Array:
        inputs = (np.concatenate([carry, control], axis=1) - self.centre_) / self.scale_
        total = np.zeros((len(carry), self.system.nx))
        for member in self.layers_:
            h = inputs
            for layer in range(3):
                h = h @ member[2 * layer] + member[2 * layer + 1]
                h = np.tanh(h) if layer < 2 else h
            total += h
        return carry[:, : self.system.nx] + total / self.members * self.change_scale_ + self.change_centre_
