"""Training of a state space whose initial states an encoder network finds in the past: Adam on truncated free runs."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor, nn

from model_zoo.hidden.records import Record
from model_zoo.hidden.shooting import FAR, Spaces
from sysid_evo.arrays import Array

CHECKS = 15
"""Times that the weights are judged."""
MOST_JUDGED = 500
STEEPEST = 1.0


class Encoded(nn.Module):
    """The space as a module, and the encoder: a linear map of the past, plus a network that begins with no weight."""

    def __init__(self, space: Spaces, first: Array, hidden: int) -> None:
        super().__init__()
        self.outer = nn.Parameter(torch.from_numpy(space.outer[0].copy()))
        self.inner = nn.Parameter(torch.from_numpy(space.inner[0].copy()))
        self.pace = torch.from_numpy(space.pace)
        self.linear = nn.Linear(first.shape[1] - 1, len(first), dtype=torch.float64)
        last = nn.Linear(hidden, len(first), dtype=torch.float64)
        self.bent = nn.Sequential(nn.Linear(first.shape[1] - 1, hidden, dtype=torch.float64), nn.Tanh(), last)
        with torch.no_grad():
            self.linear.weight.copy_(torch.from_numpy(first[:, :-1]))
            self.linear.bias.copy_(torch.from_numpy(first[:, -1]))
            last.weight.zero_()
            last.bias.zero_()

    def start(self, past: Tensor) -> Tensor:
        """Return the states (B, n) after ``past`` (B, p)."""
        found: Tensor = self.linear(past) + self.bent(past)
        return found

    def encoded(self, past: Array) -> Array:
        """Return the states (N, n) after ``past`` (N, p), as arrays."""
        with torch.no_grad():
            return self.start(torch.from_numpy(past)).numpy().copy()

    def run(self, past: Tensor, controls: Tensor, n_outputs: int) -> Tensor:
        """Return the outputs (B, H + 1, ny) of free runs under ``controls`` (B, H, nu)."""
        state, ones = self.start(past), torch.ones(len(past), 1, dtype=torch.float64)
        outputs = [state[:, :n_outputs]]
        for k in range(controls.shape[1]):
            seen = torch.cat([state, controls[:, k], ones], dim=1)
            rates = torch.cat([seen, torch.tanh(seen @ self.inner.T)], dim=1) @ self.outer.T
            state = torch.clamp(state + self.pace * rates, -FAR, FAR)
            outputs.append(state[:, :n_outputs])
        return torch.stack(outputs, dim=1)


def pasts(parts: list[Record], past: int, ahead: int) -> tuple[Array, Array, Array]:
    """Return what the encoder sees (N, p), the controls (N, ahead, nu) and outputs (N, ahead + 1, ny) from there on.

    It sees the last ``past`` outputs and controls before the present, not the present output.
    """
    rows = []
    for part in (part for part in parts if len(part) >= past + ahead):
        begins = np.arange(past, len(part) - ahead + 1)
        before, after = begins[:, None] + np.arange(-past, 0), begins[:, None] + np.arange(ahead + 1)
        seen = np.concatenate([part.outputs[before], part.controls[before]], axis=2).reshape(len(begins), -1)
        rows.append((seen, part.controls[after[:, :-1]], part.outputs[after]))
    seen, controls, outputs = (np.concatenate(columns) for columns in zip(*rows, strict=True))
    return seen, controls, outputs


def train_encoded(
    module: Encoded,
    learned: tuple[Array, Array, Array],
    held: tuple[Array, Array, Array],
    *,
    updates: int,
    batch: int,
    learning_rate: float,
    rng: np.random.Generator,
    told: Callable[[], None],
) -> None:
    """Train ``module`` in place on windows of `pasts`; the weights that run best on those ``held`` back are kept."""
    few = np.unique(np.linspace(0, len(held[0]) - 1, min(MOST_JUDGED, len(held[0]))).astype(np.int64))
    judged = [torch.from_numpy(part[few]) for part in held]
    given = [torch.from_numpy(part) for part in learned]
    ny = learned[2].shape[2]
    optimiser = torch.optim.Adam(module.parameters(), lr=learning_rate)
    rates = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, updates, 0.05 * learning_rate)
    lowest, best = math.inf, {name: value.clone() for name, value in module.state_dict().items()}
    for update in range(updates + 1):
        if update % max(1, updates // CHECKS) == 0 or update == updates:
            with torch.no_grad():
                error = float(((module.run(judged[0], judged[1], ny) - judged[2]) ** 2).mean())
            if error < lowest:
                lowest, best = error, {name: value.clone() for name, value in module.state_dict().items()}
        if update == updates:
            break
        rows = torch.from_numpy(rng.integers(0, len(given[0]), batch))
        past, controls, outputs = (part[rows] for part in given)
        optimiser.zero_grad()
        torch.autograd.backward(((module.run(past, controls, ny) - outputs) ** 2).mean())
        if torch.isfinite(nn.utils.clip_grad_norm_(module.parameters(), STEEPEST)):
            optimiser.step()
        rates.step()
        told()
    module.load_state_dict(best)
