"""A linear model of a system: x' = A x + B u + c, given or taken from any dynamics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.controllers.named import size_of
from sysid_evo.dynamics import Dynamics

STEP = 1e-4
"""Of a difference quotient, in sizes of the channel."""


@dataclass(frozen=True)
class LinearModel:
    """``a`` (nx, nx), ``b`` (nx, nu) and ``c`` (nx,), from one sample to the next."""

    a: Array
    b: Array
    c: Array

    def at_rest(self, target: Array, led: Sequence[int]) -> tuple[Array, Array]:
        """Return the state (nx,) and control (nu,) that stay as they are with the ``led`` states at ``target``.

        Where there are several the smallest, where there is none the nearest to one.
        """
        nx = len(self.a)
        wanted = np.zeros((len(led), nx + self.b.shape[1]))
        wanted[np.arange(len(led)), led] = 1.0
        still = np.concatenate([np.eye(nx) - self.a, -self.b], axis=1)
        found = np.linalg.lstsq(np.concatenate([still, wanted]), np.concatenate([self.c, target]), rcond=None)[0]
        return found[:nx], found[nx:]


def linear_model(dynamics: Dynamics, state: Array) -> LinearModel:
    """Return ``dynamics`` linearised around ``state`` (nx,) and the neutral control, by central differences.

    What it remembers beside the state is that of a system that has long been in this state, without noise.
    """
    system = dynamics.system
    neutral = system.neutral_control
    steps = STEP * np.array([size_of(channel) for channel in (*system.states, *system.controls)])
    moves = np.concatenate([np.diag(steps), -np.diag(steps), np.zeros((1, len(steps)))])
    states, controls = state + moves[:, : system.nx], neutral + moves[:, system.nx :]
    past = np.tile(neutral, (len(moves), dynamics.n_lags, 1))
    history = np.repeat(states[:, None], dynamics.n_lags + 1, axis=1)
    carry = dynamics.start(history, past, np.zeros((len(moves), dynamics.n_draws)))
    after = system.near(dynamics.step(carry, controls)[:, : system.nx], states)
    n = len(steps)
    slopes = ((after[:n] - after[n : 2 * n]) / (2.0 * steps[:, None])).T
    a, b = slopes[:, : system.nx], slopes[:, system.nx :]
    return LinearModel(a, b, after[-1] - a @ state - b @ neutral)
