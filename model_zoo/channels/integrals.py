"""States that only add up what others do: positions, and whatever else no value of its own pulls back."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from model_zoo.channels.standard import deviation
from sysid_evo.arrays import Array, BoolArray
from sysid_evo.data import Dataset
from sysid_evo.system import System

if TYPE_CHECKING:
    from sysid_evo.engine.kernels import Predictor

OWN = 0.005
"""Share of the deviation of a state's change up to which its own value does not count in it."""
RATE = 0.95
"""Share of the variance of a state's change that another state must explain to be its rate."""
AT_LIMIT = 1e-6
"""Share of the range of a channel within which a state is at its limit."""
FEWEST = 0.5
"""Share of the samples that must be left without those at a limit; else all are taken."""


def integrals(dataset: Dataset) -> BoolArray:
    """Return of which states (nx,) the change is to be predicted, not the next value: periodic ones and integrals.

    A prediction of the next state from inputs clipped to the training range is a wall at the end of that range. For a
    speed that drag holds back that is a good guess. A position runs on: nothing in the data says that it would not,
    and a controller that is evolved in the model leans on the wall. An *integral* is a state of whose change another
    state is the rate, or of whose change its own value explains nothing (linear and quadratic, beside all other states
    and controls).
    """
    system, data = dataset.system, dataset.transitions(moving=True)
    free = between_limits(system, data.after)
    state, control, after = data.state[free], data.control[free], data.after[free]
    seen = np.concatenate([system.regressors(state), control], axis=1)
    standard = (seen - seen.mean(axis=0)) / deviation(seen)
    change = system.difference(after, state)
    columns = np.concatenate([np.ones((len(seen), 1)), standard, standard**2], axis=1)
    effects, *_ = np.linalg.lstsq(columns, change / deviation(change), rcond=None)
    moved = (change - change.mean(axis=0)) / deviation(change)
    explained = (standard.T @ moved / len(moved)) ** 2
    found = np.zeros(system.nx, dtype=bool)
    for i, channel in enumerate(system.states):
        if channel.period is None:
            place = system.regressor_names.index(channel.name)
            effect = np.abs(effects[[1 + place, 1 + seen.shape[1] + place], i]).max()
            others = np.delete(explained[: len(system.regressor_names), i], place)
            is_moved = others.max(initial=0.0) >= RATE
            found[i] = (is_moved or effect < OWN) and np.ptp(state[:, i]) > 0.0
        else:
            found[i] = True
    return found


def between_limits(system: System, after: Array) -> BoolArray:
    """Return in which samples (N,) no state of ``after`` (N, nx) is at a limit of its channel.

    What stands at a limit tells of the limit, not of what drove it there. Where most samples do, all are returned.
    """
    low, high = system.limits
    width = np.where(np.isfinite(high - low), high - low, 1.0)
    free: BoolArray = ((after > low + AT_LIMIT * width) & (after < high - AT_LIMIT * width)).all(axis=1)
    return free if free.mean() >= FEWEST else np.ones(len(after), dtype=bool)


def next_state(added: Array, state: Array, predicted: Array) -> Array:
    """Return ``predicted`` (B, nx), added to ``state`` (B, nx) where ``added`` (nx,) is above 0."""
    return np.where(added > 0.0, state + predicted, predicted)


def next_state_predictor(added: Array, inner: Predictor) -> Predictor:
    """Return the compiled form of `next_state` around what predicts."""
    from sysid_evo.engine.kernels import on_top

    chosen = added > 0.0
    return on_top(inner, chosen) if chosen.any() else inner
