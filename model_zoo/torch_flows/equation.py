"""A differential equation whose right-hand side is a torch module, solved by torchdiffeq step by step."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import torch
from torch import Tensor
from torchdiffeq import odeint, odeint_adjoint

from sysid_evo.angles import TURN
from sysid_evo.free_run import chained
from sysid_evo.lags import CarryLayout
from sysid_evo.system import System

ADAPTIVE = ("dopri5", "dopri8")
"""Methods that choose their own steps; those of lower order would need too many to be as exact as a step must be."""
MOST_STEPS = 10_000
"""Steps of their own that they may take within dt."""
SOLVER_FAILED = AssertionError
"""What torchdiffeq raises where they would take more, or meet what is no number."""


@contextmanager
def one_thread(seed: int) -> Iterator[None]:
    """Let torch work on one thread, with random numbers from ``seed``; then all is as it was before."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            yield
    finally:
        torch.set_num_threads(threads)


class Turning(torch.autograd.Function):
    """w(x) of any motion, with the derivative that it has."""

    @staticmethod
    def forward(ctx: Any, state: Tensor, system: System) -> Tensor:
        """Return w(x) for states (..., nx)."""
        ctx.save_for_backward(state)
        ctx.system = system
        return torch.from_numpy(system.turning(state.detach().numpy()))

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None]:
        """Return the gradient by the states."""
        (state,) = ctx.saved_tensors
        return torch.from_numpy(ctx.system.motion_gradient().turned(state.numpy(), gradient.numpy())), None


@dataclass(frozen=True)
class Equation:
    """dx/dt = ``rates`` module((seen - ``centre``) / ``scale``) + w(x), w the rotation of the frame, all in float64.

    Seen are what `Features` lists: states, of periodic ones sine and cosine, earlier samples and the control, which
    are held over a step. ``tolerance`` is that of adaptive methods, relative and in parts of the usual change in a
    step; none of the rows of a batch is further off.
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

    def with_module(self, module: torch.nn.Module) -> Equation:
        """Return the same equation with another module."""
        return replace(self, module=module)

    def run(self, states: Tensor, past_controls: Tensor, controls: Tensor) -> Tensor:
        """Return the states (B, H, nx) of free runs from histories (B, L + 1, nx), (B, L, nu) under (B, H, nu)."""
        carry = torch.cat(self.layout.started(states, past_controls), dim=-1)

        def step(carry: Tensor, control: Tensor) -> Tensor:
            return torch.cat(self.layout.moved(carry, control, self.after(carry, control)), dim=-1)

        return torch.stack([carry[:, : self.layout.nx] for carry in chained(step, carry, controls)], dim=1)

    def after(self, carry: Tensor, control: Tensor) -> Tensor:
        """Return the state (B, nx) after dt. Raises `SOLVER_FAILED` where an adaptive method cannot get there."""
        solve, options = odeint, None
        if self.adjoint and torch.is_grad_enabled():
            solve = partial(odeint_adjoint, adjoint_rtol=self.tolerance, adjoint_atol=self.tolerance)
        if self.solver in ADAPTIVE:
            options = {"max_num_steps": MOST_STEPS, "norm": _largest}
        rate, state = Rate(self, carry[:, self.layout.nx :], control), carry[:, : self.layout.nx]
        solved: Tensor = solve(
            rate, state, self._times, rtol=self.tolerance, atol=self._absolute, method=self.solver, options=options
        )
        return solved[-1]

    @cached_property
    def _times(self) -> Tensor:
        return torch.tensor([0.0, self.system.dt], dtype=torch.float64)

    @cached_property
    def _absolute(self) -> Tensor:
        return self.tolerance * self.system.dt * self.rates


class Rate(torch.nn.Module):
    """dx/dt of one step as torchdiffeq asks for it: what is held, and what is seen of that, is computed once."""

    def __init__(self, equation: Equation, held: Tensor, control: Tensor) -> None:
        super().__init__()
        self.module, self.equation = equation.module, equation
        system, past = equation.system, equation.layout.earlier_controls.start - equation.layout.nx
        earlier = [seen(system, held[:, at : at + system.nx]) for at in range(0, past, system.nx)]
        self.n_seen = len(system.regressor_names)
        fixed = torch.cat([*earlier, held[:, past:], control], dim=1)
        self.fixed = (fixed - equation.centre[self.n_seen :]) / equation.scale[self.n_seen :]

    def forward(self, time: Tensor, state: Tensor) -> Tensor:
        """Return dx/dt (B, nx), which is the same at all times of the step."""
        equation, n = self.equation, self.n_seen
        present = (seen(equation.system, state) - equation.centre[:n]) / equation.scale[:n]
        rate: Tensor = self.module(torch.cat([present, self.fixed], dim=1)) * equation.rates
        if equation.system.motion is None:
            return rate
        turned: Any = Turning  # torch gives apply no types
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


def _largest(error: Tensor) -> Tensor:
    return error.abs().max()
