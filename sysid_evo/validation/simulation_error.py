"""Simulation (free run) on held-out windows and its error.

A model is simulated from measured states under recorded controls and compared with what was measured. Errors are
divided by the standard deviation of the recording, so that 0 is perfect and about 1 no better than its mean.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, Self

import numpy as np
import numpy.typing as npt

from sysid_evo.carry import pad_history
from sysid_evo.data.dataset import Dataset
from sysid_evo.data.trajectory import Windows, evenly_spaced
from sysid_evo.errors import InvalidData
from sysid_evo.system import System
from sysid_evo.types import Array, IntArray
from sysid_evo.validation.estimates import Draws, Estimate

SECOND, FEWEST_STEPS = 1.0, 10
"""How long a model runs freely where nothing else is asked for, in s, and in steps at least."""

STRIDE = 4
"""Samples from the start of one window to the next."""

MOST_WINDOWS = 10_000
"""Windows that judge a model: more of them take longer and say the same."""


class Fitted(Protocol):
    """A fitted model of ``system`` that starts from ``n_lags`` samples of history and clips states to
    ``state_bounds``."""

    @property
    def system(self) -> System: ...
    @property
    def n_lags(self) -> int: ...
    @property
    def state_bounds(self) -> Array | None: ...


class Simulator(Fitted, Protocol):
    """What is judged here: a fitted model that runs free."""

    def simulate(self, states: npt.ArrayLike, past_controls: npt.ArrayLike, controls: npt.ArrayLike, /) -> Array:
        """Return the states (B, H, nx) after a history (B, L + 1, nx), (B, L, nu) under controls (B, H, nu)."""
        ...


def error_windows(
    dataset: Dataset, history: int, *, stride: int = STRIDE, seconds: float = SECOND, fewest: int = FEWEST_STEPS
) -> Windows:
    """Return windows of one second and at least ten steps, or the longest the data have, wherever the body moves.

    One starts every ``stride`` samples, of long data at larger strides, so that there are `MOST_WINDOWS` or fewer.
    """
    longest = max(len(episode) for episode in dataset.episodes) - history
    horizon = min(max(fewest, round(seconds / dataset.system.dt)), longest)
    if horizon < 1:
        raise InvalidData(f"data set: no episode is longer than {history} steps, the required history")
    least = -(-dataset.n_steps // MOST_WINDOWS)
    windows = dataset.windows(horizon, stride=max(stride, least), history=history, moving=True)
    return windows if len(windows) else dataset.windows(horizon, stride=least, history=history)


def simulation_error(model: Simulator, windows: Windows) -> float:
    """Return the mean over channels and steps of RMSE / standard deviation of the truth, in free run.

    Steps count alike, so that neither the first nor the last alone decides. 0 is perfect, about 1 is no
    better than the mean of the truth; infinite if a state is not finite.
    """
    simulated = model.simulate(windows.past_states, windows.past_controls, windows.controls)
    return relative_error(model.system, simulated, windows)


def relative_error(system: System, simulated: Array, windows: Windows) -> float:
    """Return the mean over channels and steps of RMSE / spread of ``simulated`` (N, H, nx); inf if not finite."""
    off, spread = system.difference(simulated, windows.states), system.spread(windows.states)
    spread = np.where(spread > 0, spread, 1.0)
    with np.errstate(all="ignore"):
        error = float(np.mean(np.sqrt(np.mean(off**2, axis=0)) / spread))
    return error if np.isfinite(error) else float("inf")


def error_of(errors: Array) -> float:
    """Return the mean over steps and states of the root mean square over windows of ``errors`` (B, H, nx)."""
    return float(np.mean(np.sqrt(np.mean(errors**2, axis=0))))


TEST_STRIDE = 6

MOST_TESTED = 800
"""Free runs of one fold: they overlap, and more of them take longer and say the same."""


@dataclass(frozen=True)
class HeldOutTest:
    """The free runs of one fold: measured ``windows``, and the horizons (steps) at which they count."""

    windows: Windows
    horizons: tuple[int, ...]

    @classmethod
    def of(cls, held: Dataset, horizons: Sequence[int], history: int) -> Self:
        """Cut windows of what is held out, wherever the body moves; all of them where it never does for so long."""
        longest = max(horizons)
        places = held.find_windows(longest, stride=TEST_STRIDE, history=history, moving=True)
        if not len(places):
            places = held.find_windows(longest, stride=1)
        return cls(places[evenly_spaced(len(places), MOST_TESTED)], tuple(horizons))

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

    def run(self, model: Simulator) -> Array:
        """Return what ``model`` simulates (N, H, nx) at the horizons; a short history is padded with its beginning."""
        w = self.windows
        history = pad_history(w.past_states, w.past_controls, model.n_lags, model.system.neutral_control)
        found = model.simulate(*history, w.controls)
        return np.asarray(found[:, [horizon - 1 for horizon in self.horizons]])

    def diverged(self, model: Simulator, simulated: Array) -> float:
        """Return the share of the runs (N, H, nx) that reach the envelope of ``model`` or are no numbers."""
        off = ~np.isfinite(simulated)
        if model.state_bounds is not None:
            off |= (simulated <= model.state_bounds[0]) | (simulated >= model.state_bounds[1])
        return float(off.any(axis=(1, 2)).mean())


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

    @cached_property
    def draws(self) -> Draws:
        """`mean` with its draws of blocks, the same for all models that ran in the same trials."""
        count = len(self.counts)
        rows = np.concatenate([self.squares.reshape(count, -1), self.counts[:, None]], axis=1)
        mean = lambda sums: np.asarray(np.sqrt(sums[:, :-1] / sums[:, -1:]).mean(axis=1))  # noqa: E731
        return Draws.of(rows, np.arange(count), mean)

    def above(self, other: Errors) -> Estimate:
        """Return by how much it is above ``other``, in the same trials."""
        return (self.draws - other.draws).estimate


@dataclass(frozen=True)
class Scorer:
    """The tests of all folds, and the ``spread`` (nx,) of the states by which errors are divided."""

    system: System
    trials: tuple[HeldOutTest, ...]
    spread: Array

    @classmethod
    def of(cls, dataset: Dataset, trials: Sequence[HeldOutTest]) -> Self:
        """Take the spread of ``dataset``, where it moves."""
        moving = [episode.states[rows] for episode, rows in zip(dataset.episodes, dataset.moving, strict=True)]
        states = np.concatenate(moving)
        if len(states) < 2:
            states = np.concatenate([episode.states for episode in dataset.episodes])
        spread = dataset.system.spread(states)
        return cls(dataset.system, tuple(trials), np.where(spread > 0, spread, 1.0))

    def errors(self, simulated: Sequence[Array]) -> Errors:
        """Condense what a model simulated in the trials, (N, H, nx) each."""
        squares, counts = [], []
        for trial, states in zip(self.trials, simulated, strict=True):
            off = self.system.difference(states, trial.truth) / self.spread
            _, block = np.unique(trial.blocks, return_inverse=True)
            sums = np.zeros((block.max(initial=-1) + 1, *off.shape[1:]))
            np.add.at(sums, block, off**2)
            squares.append(sums)
            counts.append(np.bincount(block, minlength=len(sums)))
        return Errors(np.concatenate(squares), np.concatenate(counts).astype(np.int64))


def horizons_of(pairs: list[tuple[Dataset, Dataset]], wanted: list[int]) -> list[int]:
    """Return those of the ``wanted`` horizons (steps) that fit into what is held out; the longest possible if none."""
    longest = min(max(len(episode) for episode in held) for _, held in pairs)
    fitting = sorted({horizon for horizon in wanted if horizon <= longest - 1})
    return fitting or [max(1, longest // 2)]


LONGEST_HISTORY = 64
HISTORY_SHARE = 3
"""A history takes one part in so many of what the longest horizon leaves of what is held out."""


def history_of(pairs: list[tuple[Dataset, Dataset]], horizons: Sequence[int]) -> int:
    """Return how many samples are measured before a free run: a third of what the longest of the ``horizons`` leaves.

    A model with hidden states finds them in the history, and where that is short its runs begin far off.
    """
    typical = float(np.median([len(episode) for _, held in pairs for episode in held]))
    return int(np.clip((typical - max(horizons)) // HISTORY_SHARE, 0, LONGEST_HISTORY))
