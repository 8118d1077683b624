"""Error measures per channel, as functions of true and predicted values.

``true`` and ``predicted`` are (..., nx) in the channels' units; every measure is (nx,).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sysid_evo.errors import ShapeError
from sysid_evo.types import Array, check_last


def rmse(true: npt.ArrayLike, predicted: npt.ArrayLike) -> Array:
    """Return the root mean squared error, in the channels' units."""
    error = _errors(true, predicted)
    return np.asarray(np.sqrt(np.mean(error**2, axis=0)))


def error_std(true: npt.ArrayLike, predicted: npt.ArrayLike) -> Array:
    """Return the standard deviation of the error, in the channels' units (paper, Table 1, round brackets)."""
    return np.asarray(_errors(true, predicted).std(axis=0))


def relative_percent(true: npt.ArrayLike, predicted: npt.ArrayLike, *, rms: npt.ArrayLike | None = None) -> Array:
    """Return 100 RMSE / RMS of the signal (paper, Table 1, square brackets); nan where the signal is 0.

    ``rms`` (nx,) replaces the RMS of ``true`` if the signal has more rows.
    """
    size = np.sqrt(np.mean(_rows(true) ** 2, axis=0)) if rms is None else np.asarray(rms, dtype=np.float64)
    return 100.0 * _ratio(rmse(true, predicted), size)


def nrmse(true: npt.ArrayLike, predicted: npt.ArrayLike, *, std: npt.ArrayLike | None = None) -> Array:
    """Return RMSE / standard deviation of the truth; nan where the truth is constant.

    ``std`` (nx,) replaces that of ``true`` if the truth has more rows.
    """
    size = _rows(true).std(axis=0) if std is None else np.asarray(std, dtype=np.float64)
    return _ratio(rmse(true, predicted), size)


def fit_percent(true: npt.ArrayLike, predicted: npt.ArrayLike, *, std: npt.ArrayLike | None = None) -> Array:
    """Return 100 (1 - NRMSE): 100 is perfect, 0 is as good as the mean, negative values are worse."""
    return 100.0 * (1.0 - nrmse(true, predicted, std=std))


def mean_over_channels(values: Array) -> Array:
    """Return the mean (...) over the last axis of ``values`` (..., nx), without channels that are nan."""
    known = np.isfinite(values)
    count = known.sum(axis=-1)
    total = np.where(known, values, 0.0).sum(axis=-1)
    return np.asarray(np.where(count > 0, total / np.maximum(count, 1), np.nan))


def _rows(values: npt.ArrayLike) -> Array:
    array = np.asarray(values, dtype=np.float64)
    return array.reshape(-1, array.shape[-1])


def _errors(true: npt.ArrayLike, predicted: npt.ArrayLike) -> Array:
    truth = np.asarray(true, dtype=np.float64)
    guess = check_last("predicted", predicted, truth.shape[-1])
    if guess.shape != truth.shape:
        raise ShapeError(f"predicted: expected shape {truth.shape}, that of the truth, got {guess.shape}")
    return _rows(guess - truth)


def _ratio(numerator: Array, denominator: Array) -> Array:
    return np.divide(numerator, denominator, out=np.full_like(numerator, np.nan), where=denominator > 0)
