"""The PyTorch part of torch_ode: the equation under torchdiffeq and its training."""

from __future__ import annotations

import copy
import inspect
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, Self

import numpy as np
import torch
from torch import Tensor
from torch.optim.swa_utils import AveragedModel
from torchdiffeq import odeint, odeint_adjoint

from model_zoo.networks.neural_ode import FOLDS
from model_zoo.networks.training import (
    MOMENTUM,
    SPREAD,
    TINY,
    Batches,
    TrainingSchedule,
    TrainingWindows,
    schedule,
    step_weights,
)
from model_zoo.scaling import ChannelScaling
from sysid_evo.angles import TURN
from sysid_evo.carry import CarryLayout
from sysid_evo.data import Dataset, Windows
from sysid_evo.errors import InvalidArgument, ShapeError
from sysid_evo.models.dynamics import chained, rk4
from sysid_evo.processors import one_thread
from sysid_evo.system import System
from sysid_evo.types import Array
from sysid_evo.validation.folds import time_fold
from sysid_evo.validation.simulation_error import error_windows, relative_error

ADAPTIVE = ("dopri5", "dopri8")
"""Methods that choose their own steps; lower orders would need too many steps for the required accuracy."""
MAX_STEPS = 10_000
"""Largest number of their steps within dt."""
SOLVER_FAILED = AssertionError
"""Exception of torchdiffeq for more steps, or for values that are not finite."""

CHECKS = 12
"""How often the running mean of the weights is scored."""


class Adam:
    """Adam (Kingma, Ba 2015) with a penalty of ``decay`` / 2 times the squares of the ``parameters``.

    The steps are those of `torch.optim.Adam` to the last bit. Making one of these imports the compiler of PyTorch,
    which takes more than a second of every process.
    """

    def __init__(self, parameters: Iterable[Tensor], decay: float) -> None:
        self.decay, self.steps = decay, 0
        self.moments = [(one, torch.zeros_like(one), torch.zeros_like(one)) for one in parameters]

    @torch.no_grad()
    def step(self, rate: float) -> None:
        """Do one step along the gradients that the parameters have."""
        self.steps += 1
        for parameter, first, second in self.moments:
            if parameter.grad is not None:
                gradient = parameter.grad.add(parameter, alpha=self.decay)
                first.lerp_(gradient, 1.0 - MOMENTUM)
                second.mul_(SPREAD).addcmul_(gradient, gradient, value=1.0 - SPREAD)
                deviation = (second.sqrt() / (1.0 - SPREAD**self.steps) ** 0.5).add_(TINY)
                parameter.addcdiv_(first, deviation, value=-rate / (1.0 - MOMENTUM**self.steps))


class Turning(torch.autograd.Function):
    """w(x) of any motion, with its own derivative."""

    @staticmethod
    def forward(ctx: Any, state: Tensor, system: System) -> Tensor:
        """Return w(x) for states (..., nx)."""
        ctx.save_for_backward(state)
        ctx.system = system
        return torch.from_numpy(system.frame_rotation(state.detach().numpy()))

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None]:
        """Return the gradient by the states."""
        (state,) = ctx.saved_tensors
        return torch.from_numpy(ctx.system.motion_gradient().of_frame_rotation(state.numpy(), gradient.numpy())), None


@dataclass(frozen=True)
class Equation:
    """dx/dt = ``rates`` module((features - ``centre``) / ``scale``) + w(x), w the rotation of the frame, in float64.

    The features are those of `Features`: states (sine and cosine of periodic ones), earlier samples and the control,
    which are held over a step. ``tolerance`` is that of adaptive methods, relative and in units of the typical change
    in a step; it holds for every row of a batch.
    """

    module: torch.nn.Module
    system: System
    layout: CarryLayout
    centre: Tensor
    scale: Tensor
    rates: Tensor
    solver: str
    adjoint: bool
    tolerance: float

    def checked(self, owner: str) -> Self:
        """Return this equation; raise `ShapeError` if outputs of the module of ``owner`` are not of shape (B, nx)."""
        n_inputs, nx = len(self.centre), self.system.nx
        with torch.no_grad():
            shape = tuple(self.module.eval()(torch.zeros(2, n_inputs, dtype=torch.float64)).shape)
        if shape != (2, nx):
            raise ShapeError(
                f"{owner}.module: expected a module that turns (2, {n_inputs}) into (2, {nx}), got {shape}"
            )
        return self

    def with_weights(self, weights: Mapping[str, Array]) -> Self:
        """Return this equation, its module ready to simulate with these weights."""
        self.module.load_state_dict({name: torch.tensor(weight) for name, weight in weights.items()})
        self.module.eval()
        return self

    def next_states(self, carry: Array, control: Array) -> Array:
        """Return the states (B, nx) after dt; nan in rows where the solver fails."""
        try:
            with one_thread(0), torch.no_grad():
                return self.after(torch.tensor(carry), torch.tensor(control)).numpy()
        except SOLVER_FAILED:
            if len(carry) == 1:
                return np.full((1, self.system.nx), np.nan)
            rows = range(len(carry))
            return np.concatenate([self.next_states(carry[i : i + 1], control[i : i + 1]) for i in rows])

    def run(self, states: Tensor, past_controls: Tensor, controls: Tensor) -> Tensor:
        """Return the states (B, H, nx) of simulations from histories (B, L + 1, nx), (B, L, nu) under (B, H, nu)."""
        carry = torch.cat(self.layout.initial_parts(states, past_controls), dim=-1)

        def step(carry: Tensor, control: Tensor) -> Tensor:
            return torch.cat(self.layout.shifted_parts(carry, control, self.after(carry, control)), dim=-1)

        return torch.stack([carry[:, : self.layout.nx] for carry in chained(step, carry, controls)], dim=1)

    def after(self, carry: Tensor, control: Tensor) -> Tensor:
        """Return the state (B, nx) after dt. Raises `SOLVER_FAILED` if an adaptive method fails."""
        solve, options = odeint, None
        if self.adjoint and torch.is_grad_enabled():
            solve = partial(odeint_adjoint, adjoint_rtol=self.tolerance, adjoint_atol=self.tolerance)
        if self.solver in ADAPTIVE:
            options = {"max_num_steps": MAX_STEPS, "norm": lambda error: error.abs().max()}
        rate, state = Rate(self, carry[:, self.layout.nx :], control), carry[:, : self.layout.nx]
        solved: Tensor = solve(
            rate, state, self._times, rtol=self.tolerance, atol=self._absolute, method=self.solver, options=options
        )
        return solved[-1]

    def train(
        self,
        dataset: Dataset,
        standard: ChannelScaling,
        plan: TrainingSchedule,
        *,
        rng: np.random.Generator,
        report: Callable[[], None],
    ) -> None:
        """Train the module in place on all but the held-out blocks of time.

        Every window starts from its own measured state (multiple shooting); windows have first one step, then
        several, as in `TrainingSchedule`. The result is the running mean of the weights that simulates the
        held-out blocks best over one second. ``report`` is called after each update.
        """
        learned, held = time_fold(dataset, 0, FOLDS)
        history, module, updates = self.layout.n_lags, self.module, plan.total
        training, windows = TrainingWindows.of(learned, plan.horizon, history), error_windows(held, history)
        batches, scale = Batches([training], history), torch.from_numpy(standard.state_scale)

        def running(mean: Tensor, now: Tensor, count: Tensor | int) -> Tensor:
            return torch.lerp(now, mean, min(plan.averaging, (int(count) + 1) / (int(count) + 10)))

        mean = AveragedModel(module, avg_fn=running)
        optimiser = Adam(module.parameters(), 2.0 * plan.weight_decay)
        best, lowest = copy.deepcopy(module.state_dict()), math.inf
        for update in range(updates):
            steps, size, rate = schedule(plan, update, training.horizon)
            samples = batches.drawn(rng, size, steps)[:, 0]
            now = torch.from_numpy(np.moveaxis(samples, 0, 1).astype(np.float64))
            noise = plan.input_noise * standard.change * rng.standard_normal((size, history + 1, self.layout.nx))
            module.zero_grad()
            module.train()
            if self._pulled_back(now, torch.from_numpy(noise), scale):
                optimiser.step(rate)
            mean.update_parameters(module)
            if update + 1 == updates or (update + 1) % max(1, updates // CHECKS) == 0:
                error = replace(self, module=mean.module).error(windows)
                if error < lowest:
                    best, lowest = copy.deepcopy(mean.module.state_dict()), error
            report()
        if not math.isfinite(lowest):
            raise InvalidArgument(
                f"no simulation of the module was finite: expected one that solver={self.solver!r} can follow; "
                "give a lower learning_rate, or a module whose outputs are bounded"
            )
        module.load_state_dict(best)

    def _pulled_back(self, samples: Tensor, noise: Tensor, scale: Tensor) -> bool:
        """Set the gradients for windows (B, L + 1 + H, nx + nu), shortened to 1; return whether they are finite."""
        nx, history = self.layout.nx, self.layout.n_lags
        states, controls = samples[..., :nx], samples[..., nx:]
        try:
            found = self.run(states[:, : history + 1] + noise, controls[:, :history], controls[:, history:-1])
            error = (((found - states[:, history + 1 :]) / scale) ** 2).mean(dim=(0, 2))
            weights = torch.from_numpy(step_weights(error.detach().numpy()[:, None]))
            torch.autograd.backward((weights * error).sum())
        except SOLVER_FAILED:
            return False
        return bool(torch.isfinite(torch.nn.utils.clip_grad_norm_(self.module.parameters(), 1.0)))

    def error(self, windows: Windows) -> float:
        """Return the simulation error over ``windows``."""
        given = (torch.from_numpy(part) for part in (windows.past_states, windows.past_controls, windows.controls))
        self.module.eval()
        try:
            with torch.no_grad():
                simulated = self.run(*given).numpy()
        except SOLVER_FAILED:
            return math.inf
        return relative_error(self.system, simulated, windows)

    @cached_property
    def _times(self) -> Tensor:
        return torch.tensor([0.0, self.system.dt], dtype=torch.float64)

    @cached_property
    def _absolute(self) -> Tensor:
        return self.tolerance * self.system.dt * self.rates


@dataclass(frozen=True)
class ModuleEquation(Equation):
    """A module of states and controls in their units that ``returns`` rate, change or next state, in float64.

    ``joined``: it has one input, states and controls side by side.
    """

    returns: str = "rate"
    joined: bool = False

    @classmethod
    def of_states(cls, module: torch.nn.Module, system: System, layout: CarryLayout, returns: str) -> Self:
        """Return the equation of ``module``, converted to float64. Raises `ShapeError` for another shape of outputs."""
        if isinstance(module, torch.jit.ScriptModule):
            forward: Any = module.forward
            joined = len(forward.schema.arguments) == 2  # the first one is the module
        else:
            arguments = inspect.signature(module.forward).parameters.values()
            joined = sum(one.default is one.empty and one.kind is not one.VAR_KEYWORD for one in arguments) == 1
        none = torch.empty(0, dtype=torch.float64)
        found = cls(module.double(), system, layout, none, none, none, "rk4", False, 0.0, returns, joined)
        with torch.no_grad():
            module.eval()
            inputs = [torch.zeros(2, n, dtype=torch.float64) for n in (system.nx, system.nu)]
            first, again = found.given(*inputs), found.given(*inputs)
        if not isinstance(first, torch.Tensor):
            raise ShapeError(f"a {type(first).__name__}")
        if first.shape != (2, system.nx):
            raise ShapeError(f"outputs of shape {tuple(first.shape)} for a batch of 2")
        if not torch.equal(first.nan_to_num(), again.nan_to_num()):
            raise ShapeError("other outputs for the same inputs: it must neither keep a state nor draw random numbers")
        return found

    def given(self, state: Tensor, control: Tensor) -> Tensor:
        """Return the outputs (B, nx) of the module."""
        found: Tensor = self.module(torch.cat([state, control], dim=1)) if self.joined else self.module(state, control)
        return found

    def after(self, carry: Tensor, control: Tensor) -> Tensor:
        if self.returns == "rate":
            found: Tensor = rk4(lambda state: self.given(state, control), carry, self.system.dt)
            return found
        given = self.given(carry, control)
        return carry + given if self.returns == "change" else given


class Rate(torch.nn.Module):
    """dx/dt within one step for torchdiffeq; held inputs and their features are computed once."""

    def __init__(self, equation: Equation, held: Tensor, control: Tensor) -> None:
        super().__init__()
        self.module, self.equation = equation.module, equation
        system, past = equation.system, equation.layout.earlier_controls.start - equation.layout.nx
        earlier = [seen(system, held[:, at : at + system.nx]) for at in range(0, past, system.nx)]
        self.n_seen = len(system.regressor_names)
        fixed = torch.cat([*earlier, held[:, past:], control], dim=1)
        self.fixed = (fixed - equation.centre[self.n_seen :]) / equation.scale[self.n_seen :]

    def forward(self, time: Tensor, state: Tensor) -> Tensor:
        """Return dx/dt (B, nx), which does not depend on the time within the step."""
        equation, n = self.equation, self.n_seen
        present = (seen(equation.system, state) - equation.centre[:n]) / equation.scale[:n]
        rate: Tensor = self.module(torch.cat([present, self.fixed], dim=1)) * equation.rates
        if equation.system.motion is None:
            return rate
        turned: Any = Turning  # apply has no types in torch
        turning: Tensor = turned.apply(state, equation.system)
        return rate + turning


def seen(system: System, states: Tensor) -> Tensor:
    """Return `System.regressors` of ``states`` (B, nx)."""
    if not system.periods:
        return states
    columns: list[Tensor] = []
    for i, column in enumerate(states.unbind(dim=1)):
        if i in system.periods:
            angle = TURN / system.periods[i] * column
            columns += [torch.sin(angle), torch.cos(angle)]
        else:
            columns.append(column)
    return torch.stack(columns, dim=1)
