"""Training of a torch module on free runs from measured states: Adam, the best weights on held-out blocks of time."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor
from torch.optim.swa_utils import AveragedModel

from model_zoo.channels.standard import Standard
from model_zoo.networks.multistep import Batches, Plan, Shots, schedule, step_weights
from model_zoo.networks.trainings import MOMENTUM, SPREAD
from model_zoo.torch_flows.equation import SOLVER_FAILED, Equation
from sysid_evo.cross_validation import time_blocks
from sysid_evo.data import Dataset, Windows
from sysid_evo.errors import InvalidArgument
from sysid_evo.free_run import judging_windows, relative_error

FOLDS = 5
ON_SINGLE_STEPS = 2 / 3
"""Share of the updates, which take little time each."""
CHECKS = 12
"""Times that the running mean of the weights is judged."""


def train(
    equation: Equation,
    dataset: Dataset,
    standard: Standard,
    *,
    updates: int,
    horizon: int,
    learning_rate: float,
    rng: np.random.Generator,
    told: Callable[[], None],
) -> float:
    """Train the module of ``equation`` in place on all but the held-out blocks of time; return the error on these.

    Every window is a shot of its own from a measured state (multiple shooting), as `Plan` says: first of one step, then
    of ``horizon`` steps. What stays are, of the running means of the weights, those that simulate the held-out blocks
    best over one second. ``told`` is called after each update.
    """
    learned, held = time_blocks(dataset, 0, FOLDS)
    history, module = equation.layout.history, equation.module
    shots, windows = Shots.of(learned, horizon, history), judging_windows(held, history)
    batches, scale = Batches([shots], history), torch.from_numpy(standard.state_scale)
    single = round(ON_SINGLE_STEPS * updates)
    plan = Plan(single, updates - single, horizon, learning_rate=learning_rate)

    def running(mean: Tensor, now: Tensor, count: Tensor | int) -> Tensor:
        return torch.lerp(now, mean, min(plan.averaging, (int(count) + 1) / (int(count) + 10)))

    mean = AveragedModel(module, avg_fn=running)
    optimiser = torch.optim.Adam(module.parameters(), betas=(MOMENTUM, SPREAD), weight_decay=2.0 * plan.weight_decay)
    best, lowest = copy.deepcopy(module.state_dict()), math.inf
    for update in range(updates):
        steps, size, rate = schedule(plan, update, shots.horizon)
        samples = batches.of([rng.integers(0, len(shots), size)], steps)[:, 0]
        now = torch.from_numpy(np.moveaxis(samples, 0, 1).astype(np.float64))
        noise = plan.input_noise * standard.change * rng.standard_normal((size, history + 1, equation.layout.nx))
        for group in optimiser.param_groups:
            group["lr"] = rate
        optimiser.zero_grad()
        module.train()
        if _pulled_back(equation, now, torch.from_numpy(noise), scale):
            optimiser.step()
        mean.update_parameters(module)
        if update + 1 == updates or (update + 1) % max(1, updates // CHECKS) == 0:
            error = _judged(equation, mean.module, windows)
            if error < lowest:
                best, lowest = copy.deepcopy(mean.module.state_dict()), error
        told()
    if not math.isfinite(lowest):
        raise InvalidArgument(
            f"no free run of the module was finite: expected one that solver={equation.solver!r} can follow; "
            "give a lower learning_rate, or a module whose outputs are bounded"
        )
    module.load_state_dict(best)
    return lowest


def _pulled_back(equation: Equation, samples: Tensor, noise: Tensor, scale: Tensor) -> bool:
    """Set the gradients for windows (B, L + 1 + H, nx + nu), shortened to 1; return whether they are finite."""
    nx, history = equation.layout.nx, equation.layout.history
    states, controls = samples[..., :nx], samples[..., nx:]
    try:
        found = equation.run(states[:, : history + 1] + noise, controls[:, :history], controls[:, history:-1])
        error = (((found - states[:, history + 1 :]) / scale) ** 2).mean(dim=(0, 2))
        weights = torch.from_numpy(step_weights(error.detach().numpy()[:, None]))
        torch.autograd.backward((weights * error).sum())
    except SOLVER_FAILED:
        return False
    return bool(torch.isfinite(torch.nn.utils.clip_grad_norm_(equation.module.parameters(), 1.0)))


def _judged(equation: Equation, module: torch.nn.Module, windows: Windows) -> float:
    """Return the error of free runs over ``windows`` with the weights of ``module``."""
    given = (torch.from_numpy(part) for part in (windows.past_states, windows.past_controls, windows.controls))
    module.eval()
    try:
        with torch.no_grad():
            simulated = equation.with_module(module).run(*given).numpy()
    except SOLVER_FAILED:
        return math.inf
    return relative_error(equation.system, simulated, windows)
