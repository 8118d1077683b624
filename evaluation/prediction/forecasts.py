"""What a model predicts for the measured cases, and where its simulation leaves all reason."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from evaluation.prediction.cases import MeasuredCases
from sysid_evo.arrays import Array, BoolArray, IntArray
from sysid_evo.dynamics import DynamicsModel

NEVER = -1


@dataclass(frozen=True)
class Forecasts:
    """Predicted states: ``windows`` (N, H, nx) and one (T, nx) for each free run, clipped to the guard.

    ``touched`` (N,) and ``free_touched`` (number of free runs,) are the first step (from 1) at which
    a simulation reached the model's envelope or the guard, or stopped being a number; -1 for never.
    """

    windows: Array
    touched: IntArray
    free_runs: tuple[Array, ...]
    free_touched: IntArray


def forecast(model: DynamicsModel, cases: MeasuredCases) -> Forecasts:
    """Run ``model`` freely over all cases. A short history is padded: first state, neutral controls."""
    windows, touched = _simulate(model, *cases.history(model.n_lags), cases.windows.controls, cases.guard)
    free_runs, free_touched = [], []
    for run, history in zip(cases.free_runs, cases.free_history(model.n_lags), strict=True):
        states, first = _simulate(model, *history, run.controls[None], cases.guard)
        free_runs.append(states[0])
        free_touched.append(int(first[0]))
    return Forecasts(windows, touched, tuple(free_runs), np.array(free_touched, dtype=np.int64))


def _simulate(
    model: DynamicsModel, past_states: Array, past_controls: Array, controls: Array, guard: Array
) -> tuple[Array, IntArray]:
    if not len(controls):
        return np.empty((*controls.shape[:2], past_states.shape[2])), np.empty(0, dtype=np.int64)
    states = model.simulate(past_states, past_controls, controls)
    hit = ~np.isfinite(states).all(axis=2) | _at_limit(states, guard)
    if model.envelope is not None:
        hit |= _at_limit(states, model.envelope)
    touched = np.where(hit.any(axis=1), hit.argmax(axis=1) + 1, NEVER).astype(np.int64)
    low, high = guard
    return np.clip(np.where(np.isfinite(states), states, np.where(np.isfinite(high), high, 0.0)), low, high), touched


def _at_limit(states: Array, limits: Array) -> BoolArray:
    """Say where a state (..., nx) lies on or beyond a limit; a channel whose limits coincide has none."""
    low, high = limits
    slack = 1e-9 * np.where(np.isfinite(high - low), high - low, 0.0)
    with np.errstate(invalid="ignore"):
        reached = ((states <= low + slack) | (states >= high - slack)) & (high - low > 1e-12)
    return np.asarray(reached.any(axis=-1))
