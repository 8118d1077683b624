"""What a task is told of a robot before controllers are evolved for it: how far its states go."""

from __future__ import annotations

from itertools import product

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.data import Dataset
from sysid_evo.dynamics import Dynamics, clip_state

SECONDS = 5.0
"""For how long every extreme command is held to see how far the states go."""
MOST_COMMANDS = 243
SHARE = 0.99
"""Of the recorded samples that stay below what is called the farthest."""


def farthest_recorded(dataset: Dataset) -> Array:
    """Return the absolute value that each state stays below in 99 % of the recorded samples, (nx,)."""
    states = np.concatenate([episode.states for episode in dataset])
    return np.asarray(np.quantile(np.abs(states), SHARE, axis=0))


def farthest_driven(dynamics: Dynamics) -> Array | None:
    """Return the largest absolute value of each state under extreme commands held from rest, (nx,).

    None without controls, or where a command has no limits; what stops being a number does not count.
    """
    system = dynamics.system
    if not system.nu or not all(channel.bounded for channel in system.controls):
        return None
    ends = [sorted({channel.low, channel.neutral, channel.high}) for channel in system.controls]
    commands = np.array(list(product(*ends))[:MOST_COMMANDS])
    history = np.tile(system.neutral_state, (len(commands), dynamics.n_lags + 1, 1))
    carry = dynamics.start(
        history,
        np.tile(system.neutral_control, (len(commands), dynamics.n_lags, 1)),
        np.zeros((len(commands), dynamics.n_draws)),
    )
    noise = np.zeros((len(commands), dynamics.n_noise)) if dynamics.n_noise else None
    farthest = np.abs(system.neutral_state)
    with np.errstate(all="ignore"):
        for _ in range(round(SECONDS / system.dt)):
            carry, _ = clip_state(dynamics.step(carry, commands, noise), dynamics.envelope)
            states = np.abs(carry[:, : system.nx])
            farthest = np.maximum(farthest, np.where(np.isfinite(states), states, 0.0).max(axis=0))
    return farthest
