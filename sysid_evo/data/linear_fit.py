"""How much of every change the states and earlier controls explain, by least squares.

The change of a state is partly the answer to a control and partly what the state does by itself: a
pendulum that was pushed swings back. The fit tells the two apart, and its modes are the system's own
time scales.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from sysid_evo.angles import TURN
from sysid_evo.arrays import Array
from sysid_evo.data.dataset import Dataset
from sysid_evo.data.trajectory import Trajectory
from sysid_evo.motion import PlanarBody
from sysid_evo.system import System

INTEGRATES = 0.3
"""A mode slower than this share of the longest episode counts as integrating: it has no time scale to tell."""

BLOCK = 16384
"""Steps whose regressors are in memory at a time."""


@dataclass(frozen=True)
class LinearFit:
    """The least-squares fit of a data set's changes.

    ``rate`` (nx + one for each periodic state, nx): the change of state j per second is
    ``state_terms(states) @ rate[:, j]`` plus the answer to the controls. ``explained`` (nx,) is the
    share of the variance of the next state that states and controls explain, 0 to 1. ``scales`` are
    the time scales 1 / |eigenvalue| in s of the decaying modes, rising: decay time of a plain mode,
    1 / angular frequency of an oscillation.
    """

    rate: Array
    explained: Array
    scales: tuple[float, ...]


def fit_linear(dataset: Dataset, lags: int) -> LinearFit | None:
    """Fit changes to the state and the controls of this and ``lags`` earlier steps; None if there are too few rows.

    On a planar body the controls times the forward speed are regressors too, as a steering wheel works
    in proportion to it.
    """
    system = dataset.system
    episodes = [episode for episode in dataset if len(episode) > lags]
    if not episodes:
        return None
    rows = sum(len(episode) - lags for episode in episodes)
    n_terms = system.nx + len(system.periods)
    n_inputs = acting_controls(system, episodes[0].states[:1], episodes[0].controls[:1]).shape[1]
    if rows < 3 * (n_terms + 1 + n_inputs * (lags + 1)):
        return None
    weights = _least_squares(_blocks(system, episodes, lags))
    left = system.dt**2 * _variance(y - x @ weights for x, y in _blocks(system, episodes, lags))
    total = _variance(episode.states[lags:-1] for episode in episodes)
    explained = 1.0 - np.divide(left, total, out=np.zeros_like(left), where=total > 0.0)
    longest = max(episode.duration for episode in episodes)
    scales = _scales(weights[: system.nx], system.dt, INTEGRATES * longest)
    return LinearFit(weights[:n_terms], np.clip(explained, 0.0, 1.0), scales)


def state_terms(system: System, states: Array) -> Array:
    """Return the terms of ``states`` (T, nx) that changes are fitted to, (T, nx + one for each periodic state).

    They are the states; of a periodic one the sine, scaled so that it is the angle near neutral, and,
    after all the others, the cosine.
    """
    terms, cosines = states.copy(), []
    for i, period in system.periods.items():
        angle = (states[:, i] - system.neutral_state[i]) * TURN / period
        terms[:, i] = np.sin(angle) * period / TURN
        cosines.append(np.cos(angle))
    return np.column_stack([terms, *cosines])


def _blocks(system: System, episodes: Sequence[Trajectory], lags: int) -> Iterator[tuple[Array, Array]]:
    """Yield regressors (n, terms) and changes (n, nx) of up to `BLOCK` steps, which bounds the memory."""
    for episode in episodes:
        for first in range(lags, len(episode), BLOCK):
            last = min(first + BLOCK, len(episode))
            states = episode.states[first:last]
            inputs = acting_controls(system, episode.states[first - lags : last], episode.controls[first - lags : last])
            past = [inputs[lags - lag : len(inputs) - lag] for lag in range(lags + 1)]
            regressors = np.concatenate([state_terms(system, states), np.ones((len(states), 1)), *past], axis=1)
            yield regressors, system.acceleration(states, episode.states[first + 1 : last + 1])


def _least_squares(blocks: Iterator[tuple[Array, Array]]) -> Array:
    """Return the weights by the normal equations of scaled columns, much faster than an SVD of the rows."""
    products: Array | float = 0.0
    for regressors, targets in blocks:
        products = products + regressors.T @ np.concatenate([regressors, targets], axis=1)
    square, answer = np.split(np.asarray(products), [len(np.asarray(products))], axis=1)
    size = np.sqrt(np.diag(square))
    scale = np.where(size > 0.0, size, 1.0)
    solution = np.linalg.lstsq(square / np.outer(scale, scale), answer / scale[:, None], rcond=1e-13)[0]
    return np.asarray(solution / scale[:, None])


def _variance(blocks: Iterator[Array]) -> Array:
    """Return the variance of each column over all ``blocks`` (n, c)."""
    count, mean, squares = 0, np.zeros(1), np.zeros(1)
    for block in blocks:
        off = block.mean(axis=0) - mean
        both = count + len(block)
        squares = squares + ((block - block.mean(axis=0)) ** 2).sum(axis=0) + off**2 * count * len(block) / both
        mean = mean + off * len(block) / both
        count = both
    return np.asarray(squares / count)


def acting_controls(system: System, states: Array, controls: Array) -> Array:
    """Return the controls (T, nu), on a planar body followed by their products with the forward speed."""
    if not isinstance(system.motion, PlanarBody):
        return controls
    forward = system.motion.indices(system.state_names)[0]
    return np.concatenate([controls, controls * states[:, [forward]]], axis=1)


def _scales(rate: Array, dt: float, slowest: float) -> tuple[float, ...]:
    """Return the time scales in s of the modes that decay and are faster than ``slowest``."""
    modes = np.linalg.eigvals(np.eye(len(rate)) + dt * rate.T)
    decaying = modes[(np.abs(modes) < 1.0) & (np.abs(modes) > 0.0)]
    scales = dt / np.abs(np.log(decaying.astype(complex)))
    return tuple(sorted(float(scale) for scale in scales if scale < slowest))
