"""Simulation of held-out windows and its error.

A model is simulated from measured states under recorded controls and compared with the measured states. Errors are
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
"""Length of a simulation in s, and the least number of steps."""

STRIDE = 4
"""Samples between the starts of two windows."""

MOST_WINDOWS = 10_000
"""Largest number of windows; more would add time but hardly any information."""


class Fitted(Protocol):
    """A fitted model of ``system`` that needs ``n_lags`` samples of history and clips states to ``state_bounds``."""

    @property
    def system(self) -> System: ...
    @property
    def n_lags(self) -> int: ...
    @property
    def state_bounds(self) -> Array | None: ...


class Simulator(Fitted, Protocol):
    """A fitted model that can be simulated."""

    def simulate(self, states: npt.ArrayLike, past_controls: npt.ArrayLike, controls: npt.ArrayLike, /) -> Array:
        """Return the states (B, H, nx) after a history (B, L + 1, nx), (B, L, nu) under controls (B, H, nu)."""
        ...


def error_windows(dataset: Dataset, history: int, *, stride: int = STRIDE, fewest: int = FEWEST_STEPS) -> Windows:
    """Return windows that start in motion, of one second and at least ten steps, or the longest that the data have.

    One starts every ``stride`` samples; the stride is larger for long data, so that there are at most `MOST_WINDOWS`.
    """
    longest = max(len(episode) for episode in dataset.episodes) - history
    horizon = min(max(fewest, round(SECOND / dataset.system.dt)), longest)
    if horizon < 1:
        raise InvalidData(f"data set: no episode is longer than {history} steps, the required history")
    least = -(-dataset.n_steps // MOST_WINDOWS)
    windows = dataset.windows(horizon, stride=max(stride, least), history=history, moving=True)
    return windows if len(windows) else dataset.windows(horizon, stride=least, history=history)


def simulation_error(model: Simulator, windows: Windows) -> float:
    """Return the mean over channels and steps of RMSE / standard deviation of the truth in simulation.

    All steps have the same weight. 0 is perfect, about 1 is no better than the mean of the truth; infinite if a state
    is not finite.
    """
    simulated = model.simulate(windows.past_states, windows.past_controls, windows.controls)
    return relative_error(model.system, simulated, windows)


def relative_error(system: System, simulated: Array, windows: Windows) -> float:
    """Return the mean over channels and steps of RMSE / std of ``simulated`` (N, H, nx); inf if not finite."""
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
"""Largest number of simulations per fold; they overlap, so that more would add time but no information."""


@dataclass(frozen=True)
class HeldOutTest:
    """The test of one fold: measured ``windows``, and the horizons (steps) at which errors are computed."""

    windows: Windows
    horizons: tuple[int, ...]

    @classmethod
    def of(cls, held: Dataset, horizons: Sequence[int], history: int, most: int = MOST_TESTED) -> Self:
        """Return up to ``most`` windows of the held-out data that start in motion; any windows if there are none."""
        longest = max(horizons)
        places = held.find_windows(longest, stride=TEST_STRIDE, history=history, moving=True)
        if not len(places):
            places = held.find_windows(longest, stride=1)
        return cls(places[evenly_spaced(len(places), most)], tuple(horizons))

    @property
    def truth(self) -> Array:
        """The measured states (N, H, nx) at the horizons."""
        return self.windows.states[:, [horizon - 1 for horizon in self.horizons]]

    @property
    def blocks(self) -> IntArray:
        """The block of time (N,) of each window; blocks have the length of the longest horizon."""
        length = max(self.horizons)
        longest = int(self.windows.start.max(initial=0)) // length + 1
        return np.asarray(self.windows.episode * longest + self.windows.start // length, dtype=np.int64)

    def run(self, model: Simulator) -> Array:
        """Return the states (N, H, nx) simulated by ``model`` at the horizons; a short history is padded."""
        w = self.windows
        history = pad_history(w.past_states, w.past_controls, model.n_lags, model.system.neutral_control)
        found = model.simulate(*history, w.controls)
        return np.asarray(found[:, [horizon - 1 for horizon in self.horizons]])

    def diverged(self, model: Simulator, simulated: Array) -> float:
        """Return the share of the simulations (N, H, nx) that reach the state bounds of ``model`` or are not finite."""
        off = ~np.isfinite(simulated)
        if model.state_bounds is not None:
            off |= (simulated <= model.state_bounds[0]) | (simulated >= model.state_bounds[1])
        return float(off.any(axis=(1, 2)).mean())


@dataclass(frozen=True)
class Errors:
    """Squared errors, in units of the standard deviation of each state, summed over K blocks of time: (K, H, nx).

    ``counts`` (K,) are the windows in each block.
    """

    squares: Array
    counts: IntArray

    @property
    def at(self) -> Array:
        """The error (H,) at each horizon: RMSE / standard deviation, averaged over the states."""
        return np.asarray(np.sqrt(self.squares.sum(axis=0) / self.counts.sum()).mean(axis=-1))

    @property
    def mean(self) -> float:
        """The mean error over the horizons; infinite if it is not a number."""
        found = float(self.at.mean())
        return found if np.isfinite(found) else float("inf")

    @cached_property
    def draws(self) -> Draws:
        """`mean` with its draws of blocks, the same for all models in the same tests."""
        count = len(self.counts)
        rows = np.concatenate([self.squares.reshape(count, -1), self.counts[:, None]], axis=1)
        mean = lambda sums: np.asarray(np.sqrt(sums[:, :-1] / sums[:, -1:]).mean(axis=1))  # noqa: E731
        return Draws.of(rows, np.arange(count), mean)

    def above(self, other: Errors) -> Estimate:
        """Return the difference to ``other`` in the same tests."""
        return (self.draws - other.draws).estimate


@dataclass(frozen=True)
class Scorer:
    """The tests of all folds, and the standard deviation ``spread`` (nx,) of the states, which divides errors."""

    system: System
    trials: tuple[HeldOutTest, ...]
    spread: Array

    @classmethod
    def of(cls, dataset: Dataset, trials: Sequence[HeldOutTest]) -> Self:
        """Return the scorer of ``trials`` with the spread of ``dataset`` in motion."""
        moving = [episode.states[rows] for episode, rows in zip(dataset.episodes, dataset.moving, strict=True)]
        states = np.concatenate(moving)
        if len(states) < 2:
            states = np.concatenate([episode.states for episode in dataset.episodes])
        spread = dataset.system.spread(states)
        return cls(dataset.system, tuple(trials), np.where(spread > 0, spread, 1.0))

    def errors(self, simulated: Sequence[Array]) -> Errors:
        """Return the errors of the states ``simulated`` in each test, (N, H, nx)."""
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
    """Return the ``wanted`` horizons (steps) that fit into the held-out data, or the longest possible one."""
    longest = min(max(len(episode) for episode in held) for _, held in pairs)
    fitting = sorted({horizon for horizon in wanted if horizon <= longest - 1})
    return fitting or [max(1, longest // 2)]


LONGEST_HISTORY = 64
HISTORY_SHARE = 3
"""A history has at most 1 / this of the held-out samples that the longest horizon leaves."""


def history_of(pairs: list[tuple[Dataset, Dataset]], horizons: Sequence[int]) -> int:
    """Return the samples of history before a simulation: a third of those that the longest of the ``horizons`` leaves.

    A model with hidden states estimates them from the history; with a short one, simulations begin with large errors.
    """
    typical = float(np.median([len(episode) for _, held in pairs for episode in held]))
    return int(np.clip((typical - max(horizons)) // HISTORY_SHARE, 0, LONGEST_HISTORY))


LEAST = (10, 20, 60)
"""Horizons in samples where responses are fast: half a second to three at 20 Hz."""
SHARES = (0.2, 0.5, 1.0)
"""The same horizons where responses are slow, as shares of the slowest one."""
BLOCK_SHARE = 3
"""The longest horizon is at least 1 / this of the longest recording or block of time that is held out."""
DECAYED = np.exp(-1.0)
MOST_STEPS = 200_000
"""Steps simulated in a fold at most; there are fewer windows if they are long, so that a test takes seconds."""
MOST_LONG = 10
"""Long simulations have 1 / this of these steps."""


def selection_horizons(dataset: Dataset, pairs: list[tuple[Dataset, Dataset]]) -> list[int]:
    """Return the horizons in samples for these pairs of training and held-out data, in ascending order.

    Three follow the slowest response, up to a third of the held-out block, and are at least 10, 20 and 60 samples. A
    third of the block is added if it is longer. Horizons that do not fit into the block are left out.
    """
    third = min(max(len(episode) for episode in held) for _, held in pairs) // BLOCK_SHARE
    response = min(response_steps(dataset), third)
    wanted = {max(least, round(share * response)) for least, share in zip(LEAST, SHARES, strict=True)}
    fitting = horizons_of(pairs, sorted(wanted))
    return [*fitting, third] if third > fitting[-1] else fitting


def held_out_tests(pairs: list[tuple[Dataset, Dataset]], horizons: Sequence[int]) -> list[HeldOutTest]:
    """Return the test of each fold after these ``horizons`` in samples."""
    history = history_of(pairs, horizons)
    most = min(MOST_TESTED, max(1, MOST_STEPS // max(horizons)))
    return [HeldOutTest.of(held, horizons, history, most) for _, held in pairs]


BEYOND, LONGEST, POINTS = 4, 1000, 20
"""Recordings this many times as long as the longest horizon are simulated further: the most steps, and the number of
them after which errors are computed."""


def long_test(dataset: Dataset, horizons: Sequence[int], history: int) -> HeldOutTest | None:
    """Return a test of long simulations through the whole data; None if no recording is far longer than ``horizons``.

    Held-out blocks of time are short: only long simulations show a model that drifts.
    """
    longest = max(len(episode) for episode in dataset) - history - 1
    if longest < BEYOND * max(horizons):
        return None
    steps = min(longest, LONGEST)
    after = np.unique(np.linspace(0.0, steps, POINTS + 1)[1:].astype(int))
    return HeldOutTest.of(dataset, after.tolist(), history, max(1, MOST_STEPS // (MOST_LONG * steps)))


def response_steps(dataset: Dataset) -> int:
    """Return the slowest response of the states in samples: the first lag with an autocorrelation below 1 / e.

    The length of the longest episode if the autocorrelation stays above; 1 if no state changes.
    """
    states = [_unwrapped(dataset, episode.states) for episode in dataset]
    return max(_response([own[:, i] for own in states]) for i in range(dataset.system.nx))


def _unwrapped(dataset: Dataset, states: Array) -> npt.NDArray[np.complex128]:
    """Return ``states`` (T, nx) as complex numbers, periodic ones on the unit circle."""
    found = states.astype(np.complex128)
    for i, period in dataset.system.periods.items():
        found[:, i] = np.exp(2j * np.pi * states[:, i] / period)
    return found


def _response(values: Sequence[npt.NDArray[np.complex128]]) -> int:
    """Return the first lag with an autocorrelation below 1 / e over all episodes of a state (T,)."""
    from scipy.signal import correlate  # takes long to load

    mean, longest = np.concatenate(values).mean(), max(map(len, values))
    sums, counts = np.zeros(longest), np.zeros(longest)
    for own in values:
        count = len(own)
        sums[:count] += correlate(own - mean, own - mean, method="fft")[count - 1 :].real
        counts[:count] += np.arange(count, 0, -1)
    decayed = np.flatnonzero(sums / counts <= DECAYED * sums[0] / counts[0])
    return int(decayed[0]) or 1 if len(decayed) else longest
