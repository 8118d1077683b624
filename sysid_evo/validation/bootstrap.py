"""Intervals and paired differences by a bootstrap over blocks.

Errors of overlapping windows hang together, and so do neighbours in time: whole blocks of them are drawn (Kuensch
1989). The draws depend on the number of blocks and the seed alone, so that what is computed of two models over the
same blocks is paired.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sysid_evo.types import Array, IntArray
from sysid_evo.validation.measures import mean_over_channels

PICKS = 2**20
"""Blocks that are looked up at a time, of all draws together."""

RESAMPLES, CONFIDENCE = 1000, 0.95
"""Draws and confidence where two models are compared, see `paired_interval`."""


class Interval(NamedTuple):
    """A confidence interval."""

    low: float
    high: float

    def spans(self, value: float) -> bool:
        """Whether ``value`` lies inside."""
        return self.low <= value <= self.high


@dataclass(frozen=True)
class BlockErrors:
    """Squared errors summed over each of K blocks, (K, nx), and the number of rows in each (K,)."""

    squares: Array
    counts: IntArray

    @classmethod
    def of(cls, errors: Array, blocks: IntArray) -> BlockErrors:
        """Sum ``errors`` (N, nx) over the rows of each number in ``blocks`` (N,)."""
        numbers, row_block = np.unique(blocks, return_inverse=True)
        squares = np.zeros((len(numbers), errors.shape[1]))
        np.add.at(squares, row_block, errors**2)
        return cls(squares, np.bincount(row_block, minlength=len(numbers)).astype(np.int64))

    def rmse(self, picks: IntArray) -> Array:
        """Return the RMSE (R, nx) of each of R draws of blocks, (R, K); nan for a draw without rows."""
        few = max(1, PICKS // max(1, picks.shape[1]))
        parts = [picks[begin : begin + few] for begin in range(0, len(picks), few)]
        count = np.concatenate([self.counts[part].sum(axis=1) for part in parts])[:, None]
        total = np.concatenate([self.squares[part].sum(axis=1) for part in parts])
        mean = np.divide(total, count, out=np.full_like(total, np.nan), where=count > 0)
        return np.asarray(np.sqrt(mean))

    def resampled_n(self, std: Array, resamples: int, seed: int) -> Array:
        """Return N, the mean NRMSE over channels, of every draw (R,).

        Two models scored on the same windows meet the same draws.
        """
        picks = draw_blocks(len(self.counts), resamples, seed)
        scale = np.where(std > 0, std, np.nan)
        return mean_over_channels(self.rmse(picks) / scale)


def block_sums(values: Array, blocks: IntArray) -> Array:
    """Return ``values`` (N, C) summed over the rows of each block, (K, C); ``blocks`` (N,) numbers them in order."""
    if not len(values):
        return np.empty((0, values.shape[1]))
    return np.asarray(np.add.reduceat(values, np.flatnonzero(np.diff(blocks, prepend=blocks[0] - 1)), axis=0))


def resampled_sums(values: Array, picks: IntArray) -> Array:
    """Return the sums (R, C) of ``values`` (K, C) over the blocks of each of R draws, (R, K)."""
    few = max(1, PICKS // max(1, picks.shape[1]))
    sums = np.empty((len(picks), values.shape[1]))
    for begin in range(0, len(picks), few):
        part = picks[begin : begin + few]
        places = part + len(values) * np.arange(len(part))[:, None]
        times = np.bincount(places.ravel(), minlength=len(values) * len(part)).reshape(len(part), len(values))
        sums[begin : begin + few] = times @ values
    return sums


def draw_blocks(blocks: int, resamples: int, seed: int) -> IntArray:
    """Return ``resamples`` draws of ``blocks`` from as many, with replacement."""
    rng = np.random.default_rng(seed)
    return rng.integers(0, max(blocks, 1), (resamples, blocks), dtype=np.int64)


def interval(values: Array, confidence: float) -> Interval:
    """Return the central interval that holds the share ``confidence`` of ``values``; nan is left out."""
    known = values[np.isfinite(values)]
    return _central(known, confidence) if len(known) else Interval(float("nan"), float("nan"))


def _central(values: Array, confidence: float) -> Interval:
    tail = 50.0 * (1.0 - confidence)
    low, high = np.percentile(values, [tail, 100.0 - tail])
    return Interval(float(low), float(high))


@dataclass(frozen=True)
class Errors:
    """Squares of errors, each in units of its state's spread, summed over K blocks of time: (K, H, nx).

    ``counts`` (K,) are the windows in each block.
    """

    squares: Array
    counts: IntArray

    @property
    def at(self) -> Array:
        """The error (H,) at each horizon: RMSE / spread, the mean over the states."""
        return np.asarray(np.sqrt(self.squares.sum(axis=0) / self.counts.sum()).mean(axis=-1))

    @property
    def mean(self) -> float:
        """The error in one number: the mean over the horizons; infinite where it is no number."""
        found = float(self.at.mean())
        return found if np.isfinite(found) else float("inf")

    def resampled(self, seed: int = 0) -> Array:
        """Return `mean` in draws of whole blocks (R,), the same for all models that ran in the same trials."""
        count = len(self.counts)
        picks = draw_blocks(count, RESAMPLES, seed)
        times = np.stack([np.bincount(row, minlength=count) for row in picks]).astype(np.float64)
        total = np.tensordot(times, self.squares, axes=1) / (times @ self.counts)[:, None, None]
        return np.asarray(np.sqrt(total).mean(axis=(1, 2)))


def paired_interval(first: Errors, second: Errors) -> Interval:
    """Return the 95 % interval of the error of ``second`` minus that of ``first``, by blocks of time."""
    return _central(second.resampled() - first.resampled(), CONFIDENCE)
