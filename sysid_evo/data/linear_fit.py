"""How much of every change the states and earlier controls explain, by least squares.

The change of a state is partly the answer to a control and partly what the state does by itself: a
pendulum that was pushed swings back. The fit tells the two apart, and its modes are the system's own
time scales.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sysid_evo.angles import TURN
from sysid_evo.arrays import Array
from sysid_evo.data.dataset import Dataset
from sysid_evo.motion import PlanarBody
from sysid_evo.system import System

INTEGRATES = 0.3
"""A mode slower than this share of the longest episode counts as integrating: it has no time scale to tell."""


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
    changes = np.concatenate([system.acceleration(e.states[lags:-1], e.states[lags + 1 :]) for e in episodes])
    states = np.concatenate([e.states[lags:-1] for e in episodes])
    inputs = [acting_controls(system, e.states[:-1], e.controls) for e in episodes]
    past = [np.concatenate([u[lags - lag : len(u) - lag] for u in inputs]) for lag in range(lags + 1)]
    terms = state_terms(system, states)
    regressors = np.concatenate([terms, np.ones((len(states), 1)), *past], axis=1)
    if len(regressors) < 3 * regressors.shape[1]:
        return None
    weights = _least_squares(regressors, changes)
    left = system.dt**2 * (changes - regressors @ weights).var(axis=0)
    total = states.var(axis=0)
    explained = 1.0 - np.divide(left, total, out=np.zeros_like(left), where=total > 0.0)
    longest = max(episode.duration for episode in episodes)
    scales = _scales(weights[: system.nx], system.dt, INTEGRATES * longest)
    return LinearFit(weights[: terms.shape[1]], np.clip(explained, 0.0, 1.0), scales)


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


def _least_squares(regressors: Array, targets: Array) -> Array:
    """Return the weights by the normal equations of scaled columns, much faster than an SVD of the rows."""
    size = np.sqrt(np.mean(regressors**2, axis=0))
    scale = np.where(size > 0.0, size, 1.0)
    scaled = regressors / scale
    return np.linalg.lstsq(scaled.T @ scaled, scaled.T @ targets, rcond=1e-13)[0] / scale[:, None]


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
