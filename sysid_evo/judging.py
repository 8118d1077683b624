"""How far free runs on held-out recordings are off, at several horizons, and whether two models differ in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from sysid_evo.arrays import Array, IntArray
from sysid_evo.data import Dataset, Windows
from sysid_evo.dynamics import DynamicsModel
from sysid_evo.system import System

STRIDE = 6
MOST_WINDOWS = 800
"""Free runs of one fold: they overlap, and more of them take longer and say the same."""
LONGEST_HISTORY = 64
HISTORY_SHARE = 3
"""A history takes one part in so many of what the longest horizon leaves of what is held out."""
RESAMPLES = 1000
CONFIDENCE = 0.95


@dataclass(frozen=True)
class Trial:
    """The free runs of one fold: measured ``windows``, and the horizons (steps) at which they count."""

    windows: Windows
    horizons: tuple[int, ...]

    @classmethod
    def of(cls, held: Dataset, horizons: Sequence[int], history: int) -> Self:
        """Cut windows of what is held out, wherever the body moves; all of them where it never does for so long."""
        longest = max(horizons)
        places = held.window_places(longest, stride=STRIDE, history=history, moving=True)
        if not len(places):
            places = held.window_places(longest, stride=1)
        rows = np.arange(len(places), dtype=np.int64)
        if len(rows) > MOST_WINDOWS:
            rows = np.linspace(0, len(rows) - 1, MOST_WINDOWS).astype(np.int64)
        return cls(places[rows], tuple(horizons))

    @property
    def truth(self) -> Array:
        """The measured states (N, H, nx) at the horizons."""
        return self.windows.states[:, [horizon - 1 for horizon in self.horizons]]

    @property
    def blocks(self) -> IntArray:
        """The number of the block of time (N,) of each window: as long as the longest horizon."""
        length = max(self.horizons)
        longest = int(self.windows.start.max(initial=0)) // length + 1
        return np.asarray(self.windows.episode * longest + self.windows.start // length, dtype=np.int64)

    def run(self, model: DynamicsModel) -> Array:
        """Return what ``model`` simulates (N, H, nx) at the horizons; a short history is padded with its beginning."""
        w = self.windows
        missing = max(0, model.n_lags - w.past_controls.shape[1])
        states = np.concatenate([np.repeat(w.past_states[:, :1], missing, axis=1), w.past_states], axis=1)
        neutral = np.tile(model.system.neutral_control, (len(w), missing, 1))
        controls = np.concatenate([neutral, w.past_controls], axis=1)
        found = model.simulate(states, controls, w.controls)
        return np.asarray(found[:, [horizon - 1 for horizon in self.horizons]])

    def diverged(self, model: DynamicsModel, simulated: Array) -> float:
        """Return the share of the runs (N, H, nx) that reach the envelope of ``model`` or are no numbers."""
        off = ~np.isfinite(simulated)
        if model.envelope is not None:
            off |= (simulated <= model.envelope[0]) | (simulated >= model.envelope[1])
        return float(off.any(axis=(1, 2)).mean())


@dataclass(frozen=True)
class Judge:
    """Trials of all folds, and the ``spread`` (nx,) of the states by which errors are divided."""

    system: System
    trials: tuple[Trial, ...]
    spread: Array

    @classmethod
    def of(cls, dataset: Dataset, trials: Sequence[Trial]) -> Self:
        moving = [episode.states[rows] for episode, rows in zip(dataset.episodes, dataset.moving, strict=True)]
        states = np.concatenate(moving)
        if len(states) < 2:
            states = np.concatenate([episode.states for episode in dataset.episodes])
        spread = dataset.system.spread(states)
        return cls(dataset.system, tuple(trials), np.where(spread > 0, spread, 1.0))

    def errors(self, simulated: Sequence[Array]) -> Errors:
        """Condense what a model simulated in the trials, (N, H, nx) each."""
        squares, counts, first = [], [], 0
        for trial, states in zip(self.trials, simulated, strict=True):
            off = self.system.difference(states, trial.truth) / self.spread
            _, block = np.unique(trial.blocks, return_inverse=True)
            sums = np.zeros((block.max(initial=-1) + 1, *off.shape[1:]))
            np.add.at(sums, block, off**2)
            squares.append(sums)
            counts.append(np.bincount(block, minlength=len(sums)))
            first += len(sums)
        return Errors(np.concatenate(squares), np.concatenate(counts).astype(np.int64))


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
        picks = np.random.default_rng(seed).integers(0, count, (RESAMPLES, count))
        times = np.stack([np.bincount(row, minlength=count) for row in picks]).astype(np.float64)
        total = np.tensordot(times, self.squares, axes=1) / (times @ self.counts)[:, None, None]
        return np.asarray(np.sqrt(total).mean(axis=(1, 2)))


def interval(first: Errors, second: Errors) -> tuple[float, float]:
    """Return the 95 % interval of the error of ``second`` minus that of ``first``: paired, by blocks of time."""
    tail = 50.0 * (1.0 - CONFIDENCE)
    low, high = np.percentile(second.resampled() - first.resampled(), [tail, 100.0 - tail])
    return float(low), float(high)


def horizons_of(pairs: list[tuple[Dataset, Dataset]], wanted: list[int]) -> list[int]:
    """Return those of the ``wanted`` horizons (steps) that fit into what is held out; the longest possible if none."""
    longest = min(max(len(episode) for episode in held) for _, held in pairs)
    fitting = sorted({horizon for horizon in wanted if horizon <= longest - 1})
    return fitting or [max(1, longest // 2)]


def history_of(pairs: list[tuple[Dataset, Dataset]], horizons: Sequence[int]) -> int:
    """Return how many samples are measured before a free run: a third of what the longest of the ``horizons`` leaves.

    A model with hidden states finds them in the history, and where that is short its runs begin far off.
    """
    typical = float(np.median([len(episode) for _, held in pairs for episode in held]))
    return int(np.clip((typical - max(horizons)) // HISTORY_SHARE, 0, LONGEST_HISTORY))
