"""Training on free runs: members side by side, from measured states, over windows of growing length.

Every window is a shot of its own that starts at a measured state (multiple shooting with the
measurements as nodes). The error of each step counts by the inverse of its present size to the
power 2.5, so that the first steps matter more than the last, which they decide.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from model_zoo.networks.network import Network
from model_zoo.networks.trainings import Standing, Trainings
from sysid_evo.arrays import Array
from sysid_evo.data import Dataset, Windows
from sysid_evo.free_run import chained
from sysid_evo.lags import CarryLayout

SHARPNESS = 2.5
"""Power of the weight of a step: 1 would let all steps weigh alike, more favours the accurate first ones."""

TOLD_EVERY = 10
"""Updates between two reports of progress."""

FLOOR = 0.002
"""Square of a relative error below which a step gains no more weight (the noise of the measurement)."""


class TorchModel(ABC):
    """M models with differentiable steps; the carry is (M, B, n), laid out as ``layout`` says."""

    layout: CarryLayout
    parameters: list[Tensor]
    generators: tuple[torch.Generator, ...] = ()
    """What `augmented` draws from."""

    @abstractmethod
    def step(self, carry: Tensor, control: Tensor) -> Tensor:
        """Return the next carry under ``control`` (M, B, nu)."""

    def augmented(self, batch: list[Tensor]) -> list[Tensor]:
        """Return what is learned from a batch (past states, past controls, controls, states)."""
        return batch

    def as_recorded(self) -> None:
        """Expect data as recorded from here on, to be judged by them."""
        return


@dataclass(frozen=True)
class Plan:
    """How long and how hard to train.

    First ``one_step_updates`` on single steps with batches of 512, then ``updates`` on free runs of
    ``horizon`` steps with ``batch`` windows. ``input_noise`` is added to measured states, in units
    of their one-step change. The weights are a running mean (``averaging``) of those visited;
    every ``check_every`` updates it is judged, and the best judged one is kept.
    """

    one_step_updates: int
    updates: int
    horizon: int
    batch: int = 96
    learning_rate: float = 6e-3
    weight_decay: float = 1e-5
    input_noise: float = 0.05
    averaging: float = 0.99
    check_every: int = 100

    @property
    def total(self) -> int:
        return self.one_step_updates + self.updates


@dataclass(frozen=True)
class Shots:
    """The windows of one member as tensors, and the scales of its errors and noise, (nx,) each."""

    past_states: Tensor
    past_controls: Tensor
    controls: Tensor
    states: Tensor

    @classmethod
    def of(cls, dataset: Dataset, horizon: int, history: int) -> Shots:
        """Cut windows at every moving sample, as long as ``horizon`` or as the data allow."""
        longest = max(len(episode) for episode in dataset.episodes) - history
        windows = dataset.windows(min(horizon, longest), history=history, moving=True)
        return cls.from_windows(windows)

    @classmethod
    def from_windows(cls, windows: Windows) -> Shots:
        """Turn windows into single-precision tensors."""
        arrays = (windows.past_states, windows.past_controls, windows.controls, windows.states)
        return cls(*(single(array) for array in arrays))

    def __len__(self) -> int:
        return len(self.states)


def train(
    model: TorchModel,
    shots: Sequence[Shots],
    plan: Plan,
    *,
    state_scale: Tensor,
    change_scale: Tensor,
    trainings: Trainings,
    judge: Callable[[list[Tensor]], Array] | None = None,
) -> list[Tensor]:
    """Train ``model`` on one set of ``shots`` for each member and return its averaged parameters.

    ``judge`` gives the validation error (M,) of parameters; each member then ends with the best it
    had. ``state_scale`` and ``change_scale`` (nx,) measure errors and noise. It is the next of ``trainings``: done
    already, stopped before its end, or not begun.
    """
    done = trainings.ended()
    if done is not None:
        trainings.report(plan.total)
        return done
    members, rng = len(shots), trainings.rng
    noise = torch.Generator().manual_seed(int(rng.integers(2**31)))
    optimiser = torch.optim.Adam(model.parameters, lr=plan.learning_rate, betas=(0.9, 0.99))
    mean = [parameter.detach().clone() for parameter in model.parameters]
    best = [parameter.clone() for parameter in mean]
    lowest = np.full(members, np.inf)
    longest = min(shot.states.shape[1] for shot in shots)
    standing = Standing(model.parameters, optimiser, mean, best, lowest, (noise, *model.generators))
    first = told = trainings.resume(standing)
    if first:
        trainings.report(first)
    for update in range(first, plan.total):
        horizon, size, rate = _schedule(plan, update, longest)
        for group in optimiser.param_groups:
            group["lr"] = rate
        rows = [torch.from_numpy(rng.integers(0, len(shot), size)) for shot in shots]
        batch = [
            torch.stack([getattr(shot, name)[row] for shot, row in zip(shots, rows, strict=True)])
            for name in ("past_states", "past_controls", "controls", "states")
        ]
        past, past_controls, controls, states = model.augmented(batch)
        if plan.input_noise:
            past = past + plan.input_noise * change_scale * torch.randn(past.shape, generator=noise)
        simulated = free_run(model, past, past_controls, controls[:, :, :horizon])
        error = (((simulated - states[:, :, :horizon]) / state_scale) ** 2).mean(dim=(1, 3))
        loss = (error * step_weights(error.detach())).sum()
        loss = loss + plan.weight_decay * torch.stack([(p**2).sum() for p in model.parameters]).sum()
        optimiser.zero_grad()
        torch.autograd.backward(loss)
        norm = torch.nn.utils.clip_grad_norm_(model.parameters, math.sqrt(members))
        if torch.isfinite(norm):
            optimiser.step()
        keep = min(plan.averaging, (update + 1) / (update + 10))
        with torch.no_grad():
            for average, parameter in zip(mean, model.parameters, strict=True):
                average.lerp_(parameter, 1.0 - keep)
        last = update + 1 == plan.total
        if judge is not None and (last or (update + 1) % plan.check_every == 0):
            errors = judge(mean)
            for member in np.flatnonzero(errors < lowest):
                lowest[member] = errors[member]
                for kept, average in zip(best, mean, strict=True):
                    kept[member] = average[member]
        if last or update % TOLD_EVERY == 0:
            trainings.reached(update + 1, standing)
            trainings.report(update + 1 - told)
            told = update + 1
    found = mean if judge is None else best
    trainings.end(found)
    return found


def step_weights(error: Tensor) -> Tensor:
    """Return the weights (H,) of the steps of a free run, their sum 1, for the square errors (M, H) they have now."""
    weight = (error.mean(dim=0) + FLOOR) ** -SHARPNESS
    return weight / weight.sum()


def free_run(model: TorchModel, past_states: Tensor, past_controls: Tensor, controls: Tensor) -> Tensor:
    """Return the states (M, B, H, nx) of a free run under ``controls`` (M, B, H, nu)."""
    nx = past_states.shape[-1]
    start = torch.cat(model.layout.started(past_states, past_controls), dim=-1)
    return torch.stack([carry[..., :nx] for carry in chained(model.step, start, controls)], dim=2)


def judged(model: TorchModel, parameters: Sequence[Tensor], held: Sequence[Shots], state_scale: Tensor) -> Array:
    """Return the error (M,) of each member's free runs over its own windows: RMSE / scale, the mean over all.

    Infinite where a run is not finite.
    """
    trained, errors = model.parameters, np.empty(len(held))
    model.as_recorded()
    with torch.no_grad():
        for member, shots in enumerate(held):
            model.parameters = [parameter[member : member + 1] for parameter in parameters]
            run = free_run(model, shots.past_states[None], shots.past_controls[None], shots.controls[None])
            error = (((run[0] - shots.states) / state_scale) ** 2).mean(dim=0).sqrt().mean()
            errors[member] = float(error) if bool(torch.isfinite(error)) else np.inf
    model.parameters = trained
    return errors


def forward_pass(parameters: Sequence[Tensor], values: Tensor) -> Tensor:
    """Return the outputs (M, B, n_out) of tanh layers; ``parameters`` alternate weight and bias (M, 1, n)."""
    layers = len(parameters) // 2
    for layer in range(layers):
        values = torch.baddbmm(parameters[2 * layer + 1], values, parameters[2 * layer])
        if layer < layers - 1:
            values = torch.tanh(values)
    return values


def as_tensors(network: Network) -> list[Tensor]:
    """Return alternating weights and biases (M, 1, n), ready to be trained."""
    pairs = zip(network.weights, network.biases, strict=True)
    return [single(array).requires_grad_(True) for weight, bias in pairs for array in (weight, bias[:, None])]


def as_network(parameters: Sequence[Tensor]) -> Network:
    """Undo `as_tensors`."""
    arrays = [parameter.detach().numpy().astype(np.float64) for parameter in parameters]
    return Network(arrays[0::2], [bias[:, 0] for bias in arrays[1::2]])


def single(array: Array) -> Tensor:
    """Return ``array`` as a tensor of single precision."""
    return torch.from_numpy(np.array(array, dtype=np.float32))


def _schedule(plan: Plan, update: int, longest: int) -> tuple[int, int, float]:
    """Return the horizon, the number of windows and the learning rate of one update."""
    if update < plan.one_step_updates:
        share = update / plan.one_step_updates
        return 1, 512, plan.learning_rate * (0.2 + 0.8 * math.cos(0.5 * math.pi * share))
    index = update - plan.one_step_updates
    share = index / plan.updates
    rate = plan.learning_rate * (0.02 + 0.49 * (1.0 + math.cos(math.pi * share))) * min(1.0, (index + 1) / 20)
    return min(plan.horizon, longest), plan.batch, rate
