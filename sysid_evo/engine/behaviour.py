"""What a controller does, in a few numbers: how much of its time each state and control is above, and below, neutral.

They are taken while a rollout runs, from every `EVERY`-th step, so that nothing has to be recorded.
"""

from __future__ import annotations

import numpy as np

from sysid_evo.arrays import Array, BoolArray, IntArray
from sysid_evo.system import System

EVERY = 5
"""Steps from one sample to the next; odd, so that a control that changes at every other step is seen on both sides."""


def behaviour_names(system: System) -> tuple[str, ...]:
    """Return what the descriptors of `Rollouts.behaviour` are called, two for each state and then each control."""
    channels = (*system.states, *system.controls)
    return tuple(f"{channel.name} {side}" for channel in channels for side in ("above", "below"))


def neutral(system: System) -> Array:
    """Return the neutral value of each state and then each control, (nx + nu,)."""
    return np.concatenate([system.neutral_state, system.neutral_control])


def sides(states: Array, controls: Array, centre: Array) -> BoolArray:
    """Return whether each value of states (B, nx) and controls (B, nu) is above ``centre``, and below: (B, d)."""
    off = np.concatenate([states, controls], axis=1) - centre
    return np.stack([off > 0.0, off < 0.0], axis=2).reshape(len(off), -1)


def shares(counts: Array, survived: IntArray, diverged: BoolArray) -> Array:
    """Return the descriptors (B, d), shares in [0, 1], from the samples counted; 0 for a rollout that diverged."""
    samples = np.maximum(1, -(-survived // EVERY))[:, None]
    return np.where(diverged[:, None], 0.0, counts / samples)
