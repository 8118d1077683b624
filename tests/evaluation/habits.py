"""Robots with one wrong habit planted into them, and trajectories of driving them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.data import Trajectory
from sysid_evo.dynamics import Dynamics

Habit = Callable[[Array, Array, Array], Array]
"""What becomes of the next state (B, nx), given the state before and the control."""
TRIALS, STEPS = 8, 500


class Planted(Dynamics):
    """``base`` with a ``habit``: it changes the state that every step leads to."""

    def __init__(self, base: Dynamics, habit: Habit) -> None:
        self.base, self.habit = base, habit
        self.system, self.n_carry, self.n_lags, self.n_draws = base.system, base.n_carry, base.n_lags, base.n_draws

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        return self.base.start(states, controls, draws)

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        nx = self.system.nx
        after = self.base.step(carry, control)
        return np.concatenate([self.habit(carry[:, :nx], control, after[:, :nx]), after[:, nx:]], axis=1)


def driven(dynamics: Dynamics, *, seed: int = 1, let_go: bool = False) -> list[Trajectory]:
    """Drive from rest with commands that are held for 0.3 to 1.2 s; with ``let_go`` from anywhere and without any."""
    rng, system = np.random.default_rng(seed), dynamics.system
    holds = rng.integers(6, 25, (TRIALS, STEPS, 1))
    at = np.minimum(np.argmax(np.cumsum(holds, axis=1) > np.arange(STEPS)[:, None, None].T, axis=1), STEPS - 1)
    raw = rng.choice([-1.0, 0.0, 1.0], (TRIALS, STEPS, system.nu))
    commands = np.take_along_axis(raw, np.broadcast_to(at.reshape(TRIALS, STEPS, 1), raw.shape), axis=1)
    controls = system.actuate(0.0 * commands if let_go else commands)
    begin = rng.uniform(-2.5, 2.5, (TRIALS, system.nx)) * let_go
    history = np.repeat(begin[:, None], dynamics.n_lags + 1, axis=1)
    carry = dynamics.start(history, np.tile(system.neutral_control, (TRIALS, dynamics.n_lags, 1)))
    states = [begin]
    for k in range(STEPS):
        carry = dynamics.step(carry, controls[:, k])
        states.append(carry[:, : system.nx])
    runs = np.stack(states, axis=1)
    return [Trajectory(runs[i], controls[i], system.dt, name=str(i)) for i in range(TRIALS)]
