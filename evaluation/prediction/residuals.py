"""One-step residuals: are they white noise, and are they correlated with the controls?

The residuals of a perfect model are white noise: they cannot be predicted from earlier residuals or from controls. Both
tests allow for noise that is larger in some states than in others, which the classic ones (Ljung and Box 1978) take for
correlation: Dalla, Giraitis and Phillips, "Robust tests for white noise and cross-correlation", Econometric Theory 38
(2022). The bands of cross-correlations come from sums over blocks, so that correlated noise is not mistaken for an
effect of the controls.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, stdtr, stdtrit

from sysid_evo.data import Dataset
from sysid_evo.models import DynamicsModel
from sysid_evo.types import Array, BoolArray

LAGS = 20
"""Lags of the autocorrelation, and of controls before the step."""
AHEAD = 5
"""Lags of controls after the step: feedback control causes correlations there that are no error of a model."""
BLOCK = 2 * LAGS
"""Steps of a block whose products are summed for the bands of cross-correlations."""
FEWEST_BLOCKS = 4
LEVEL = 0.05
"""Share of white, uncorrelated residuals that fail a test."""
MOST_STEPS, PART = 20_000, 2_000
"""Maximum number of steps that are used, and the length of the evenly spread blocks taken from longer data."""


@dataclass(frozen=True)
class OneStepErrors:
    """One-step errors, measured minus predicted, in rows in order of time.

    ``errors`` (M, nx) are NaN where nothing was predicted; between episodes there are as many rows of NaN as the
    longest lag. ``states`` (M, nx) and ``controls`` (M, nu) are those at the start of each step.
    """

    errors: Array
    states: Array
    controls: Array

    @property
    def scored(self) -> BoolArray:
        """Which rows contain an error, (M,)."""
        return np.asarray(np.isfinite(self.errors).all(axis=1))


def step_errors(model: DynamicsModel, dataset: Dataset, *, first: int = 0) -> OneStepErrors:
    """Predict every step that starts and ends in motion, from sample ``first`` or the first with enough history."""
    system = dataset.system
    windows = dataset.windows(1, history=model.n_lags, first=first, moving=True)
    some = np.arange(len(windows))
    if len(windows) > MOST_STEPS:
        parts = np.linspace(0, len(windows) - PART, MOST_STEPS // PART).round().astype(np.int64)
        some = (parts[:, None] + np.arange(PART)).ravel()
    windows = windows[some]
    lengths = [len(episode) + 1 + LAGS for episode in dataset]
    begins = np.cumsum([0, *lengths])
    states, controls = np.full((begins[-1], system.nx), np.nan), np.full((begins[-1], system.nu), np.nan)
    for begin, episode in zip(begins, dataset, strict=False):
        states[begin : begin + len(episode) + 1] = episode.states
        controls[begin : begin + len(episode)] = episode.controls
    errors = np.full_like(states, np.nan)
    if len(windows):
        predicted = model.simulate(windows.past_states, windows.past_controls, windows.controls)[:, 0]
        off = system.difference(windows.states[:, 0], predicted)
        lands = np.concatenate([np.append(rows, np.zeros(LAGS, dtype=bool)) for rows in dataset.moving])
        rows = begins[windows.episode] + windows.start
        kept = lands[rows + 1] & np.isfinite(off).all(axis=1)
        errors[rows[kept]] = off[kept]
    return OneStepErrors(errors, states, controls)


@dataclass(frozen=True)
class Residuals:
    """Correlations of one-step errors; ``samples`` of them, channels nx, controls nu.

    ``autocorrelation`` (LAGS, nx) from lag 1, with the ``band`` (LAGS, nx) that contains 95 % of white noise;
    ``white_p`` (nx,) is the probability of such correlations at all lags together for white noise. ``cross``
    (AHEAD + LAGS + 1, nu, nx) is the correlation with each control from ``AHEAD`` steps after the step's own to
    ``LAGS`` steps before it, with its 95 % ``cross_band``; ``cross_p`` (nu, nx) is the probability of such a
    correlation at any lag from 0 for an unrelated control. All are NaN without enough samples.
    """

    samples: int
    autocorrelation: Array
    band: Array
    white_p: Array
    cross: Array
    cross_band: Array
    cross_p: Array

    @property
    def white(self) -> BoolArray:
        """Which channels (nx,) are compatible with white noise."""
        return ~np.asarray(self.white_p < LEVEL)

    def largest_lag(self, channel: int) -> int:
        """Return the lag in steps, from 1, at which a channel's autocorrelation exceeds its band most."""
        return 1 + int(np.nan_to_num(np.abs(self.autocorrelation) / self.band)[:, channel].argmax())

    def control_lag(self, control: int, channel: int) -> int:
        """Return the lag in steps, from 0, at which a control correlates most with a channel's error."""
        past = slice(AHEAD, None)
        size = np.abs(self.cross[past, control, channel]) / self.cross_band[past, control, channel]
        return int(np.nan_to_num(size).argmax())


def analyse_residuals(steps: OneStepErrors) -> Residuals:
    """Return autocorrelation and cross-correlation of one-step errors."""
    errors = steps.errors - _mean(steps.errors)
    controls = steps.controls - _mean(steps.controls)
    autocorrelation, band, white_p = _autocorrelation(errors)
    cross, cross_band, cross_p = _cross_correlation(errors, controls)
    return Residuals(int(steps.scored.sum()), autocorrelation, band, white_p, cross, cross_band, cross_p)


def _autocorrelation(errors: Array) -> tuple[Array, Array, Array]:
    nx = errors.shape[1]
    variance = np.nansum(errors**2, axis=0)
    sums, sizes = np.zeros((LAGS, nx)), np.zeros((LAGS, nx))
    for lag in range(1, LAGS + 1):
        products = errors[lag:] * errors[:-lag]
        sums[lag - 1], sizes[lag - 1] = np.nansum(products, axis=0), np.sqrt(np.nansum(products**2, axis=0))
    statistic = (_ratio(sums, sizes) ** 2).sum(axis=0)
    return _ratio(sums, variance), 1.96 * _ratio(sizes, variance), np.asarray(chdtrc(LAGS, statistic))


def _cross_correlation(errors: Array, controls: Array) -> tuple[Array, Array, Array]:
    nx, nu, rows = errors.shape[1], controls.shape[1], len(errors)
    lags = range(-AHEAD, LAGS + 1)
    cross, spread = np.zeros((len(lags), nu, nx)), np.zeros((len(lags), nu, nx))
    scored = np.isfinite(errors).all(axis=1)
    scale = np.sqrt(np.outer(np.nansum(controls[scored] ** 2, axis=0), np.nansum(errors**2, axis=0)))
    blocks = np.arange(rows) // BLOCK
    used = np.unique(blocks[scored])
    counted = len(used)
    for place, lag in enumerate(lags):
        moved = np.full_like(controls, np.nan)
        moved[max(lag, 0) : rows + min(lag, 0)] = controls[max(-lag, 0) : rows - max(lag, 0)]
        products = np.nan_to_num(moved[:, :, None] * errors[:, None, :])
        cross[place] = _ratio(products.sum(axis=0), scale)
        if counted < FEWEST_BLOCKS:
            continue
        sums = np.add.reduceat(products, np.arange(0, rows, BLOCK), axis=0)[used]
        spread[place] = _ratio(np.sqrt(counted * sums.var(axis=0) * counted / (counted - 1)), scale)
    if counted < FEWEST_BLOCKS:
        return cross, np.full_like(cross, np.nan), np.full((nu, nx), np.nan)
    freedom = counted - 1
    largest = np.nan_to_num(_ratio(np.abs(cross), spread)[AHEAD:]).max(axis=0)
    single = 2.0 * stdtr(freedom, -largest)
    return cross, float(stdtrit(freedom, 0.975)) * spread, np.minimum(1.0, single * (LAGS + 1))


def _mean(values: Array) -> Array:
    known = np.isfinite(values)
    return np.asarray(np.where(known, values, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1))


def _ratio(top: Array, bottom: Array) -> Array:
    shape = np.broadcast_shapes(top.shape, bottom.shape)
    return np.divide(top, bottom, out=np.full(shape, np.nan), where=bottom > 0.0)
