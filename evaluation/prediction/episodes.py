"""How far off a model is in each test episode, and its fit as MATLAB's ``compare`` shows it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from evaluation.prediction import metrics
from evaluation.prediction.cases import MeasuredCases
from evaluation.prediction.metrics import mean_over_channels
from sysid_evo.arrays import Array


@dataclass(frozen=True)
class EpisodeError:
    """N of one episode at each scored horizon (H,), in the scale of the whole test set; nan without a window there.

    ``fit`` (nx,) is 100 (1 - norm(y - yhat) / norm(y - mean(y))) of each channel over the free run from the episode's
    first samples to its end, every sample of it; nan where there is no free run.
    """

    name: str
    n: Array
    fit: Array


def episode_errors(cases: MeasuredCases, windows: Array, free_runs: Sequence[Array]) -> tuple[EpisodeError, ...]:
    """Return the errors of each test episode; ``windows`` (N, H, nx) and ``free_runs`` are what was predicted."""
    fits = {
        run.episode: _fit(cases, run.states, predicted)
        for run, predicted in zip(cases.free_runs, free_runs, strict=True)
    }
    errors = cases.system.difference(windows, cases.windows.states)
    nothing = np.full(cases.system.nx, np.nan)
    return tuple(
        EpisodeError(
            name,
            np.array([_n(errors, cases, cases.windows.episode == number, horizon) for horizon in cases.horizons]),
            fits.get(name, nothing),
        )
        for number, name in enumerate(cases.test.names)
    )


def _n(errors: Array, cases: MeasuredCases, inside: np.ndarray, horizon: int) -> float:
    scored = errors[inside & cases.moving[:, horizon - 1], horizon - 1]
    if not len(scored):
        return float("nan")
    std = np.where(cases.std > 0, cases.std, np.nan)
    return float(mean_over_channels(np.sqrt(np.mean(scored**2, axis=0)) / std))


def _fit(cases: MeasuredCases, measured: Array, predicted: Array) -> Array:
    if not len(measured):
        return np.full(cases.system.nx, np.nan)
    guess = cases.system.near(predicted, measured)
    return metrics.fit_percent(measured, guess, std=cases.system.spread(measured))
