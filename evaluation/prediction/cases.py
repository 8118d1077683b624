"""Test cases of prediction: protocol, windows, whole episodes, scales, limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from evaluation.formatting import few
from sysid_evo.data import Dataset, Trajectory, Windows
from sysid_evo.errors import InvalidArgument, InvalidData
from sysid_evo.system import System
from sysid_evo.types import Array, BoolArray, IntArray
from sysid_evo.validation.estimates import CONFIDENCE
from sysid_evo.validation.measures import mean_over_channels


@dataclass(frozen=True)
class PredictionProtocol:
    """Rules for the windows to simulate, the errors that count, and the blocks of intervals.

    A window starts at every ``stride``-th sample from sample ``first``, wherever the body moves, and is simulated under
    the recorded controls for the longest of ``horizons`` (steps). A model gets as many earlier samples as it uses, if
    the record has them, but ``history`` at most. The error counts *at* each horizon, not averaged up to it, and only
    where the target moves. A simulation of a whole episode starts at its sample ``first``.

    Windows overlap, so intervals are over blocks: ``block_windows`` consecutive windows, or ``block_samples``
    consecutive samples of a simulated episode.

    Predictions are clipped to ``guard_multiple`` times the largest absolute training value.
    """

    horizons: tuple[int, ...] = (1, 10, 20, 60)
    stride: int = 4
    history: int | None = None
    first: int = 5
    block_windows: int = 15
    block_samples: int = 100
    guard_multiple: float = 2.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "horizons", tuple(sorted({int(horizon) for horizon in self.horizons})))
        if not self.horizons or self.horizons[0] < 1:
            raise InvalidArgument(f"protocol: expected horizons of one step or more, got {self.horizons}")
        for name in ("stride", "block_windows", "block_samples"):
            if getattr(self, name) < 1:
                raise InvalidArgument(f"protocol: expected {name} >= 1, got {getattr(self, name)}")
        if not 0 <= self.given <= self.first:
            raise InvalidArgument(
                f"protocol: expected 0 <= history <= first, got history {self.history}, first {self.first}"
            )
        if self.guard_multiple <= 0.0:
            raise InvalidArgument(f"protocol: expected guard_multiple > 0, got {self.guard_multiple}")

    @property
    def given(self) -> int:
        """Number of earlier samples that every window has."""
        return self.first if self.history is None else self.history

    @property
    def history_in_words(self) -> str:
        """The history that models get, in words."""
        return "as much history as a model wants" if self.history is None else f"{self.history} samples of history"

    def at(self, dt: float) -> PredictionProtocol:
        """Return the protocol for samples ``dt`` seconds apart.

        If no default horizon is at least half of `headline_steps`, that one is added to them.
        """
        wanted, chosen = headline_steps(dt), main_horizon(self.horizons, dt)
        far = self.horizons == PredictionProtocol.horizons and chosen is not None and 2 * chosen < wanted
        return replace(self, horizons=(*self.horizons, wanted)) if far else self

    def describe(self, dt: float) -> str:
        """Return the rules in one sentence; ``dt`` is in seconds."""
        return (
            f"Simulation under recorded controls from measured states with {self.history_in_words}; "
            f"starts every {self.stride} samples where the body moves; error at the horizon; dt {dt:g} s; "
            f"{100 * CONFIDENCE:g} % intervals by bootstrap over blocks of {self.block_windows} windows."
        )


SECOND, FEW, MANY = 1.0, 2, 10


def headline_steps(dt: float) -> int:
    """Return the main number of steps after which errors are compared: those nearest to one second.

    Ten if a second has fewer than two: after a single step models do not differ from persistence. Ten is also the
    shortest simulation of `simulation_error`.
    """
    steps = round(SECOND / dt)
    return steps if steps >= FEW else MANY


def main_horizon(horizons: Sequence[int], dt: float) -> int | None:
    """Return the longest of the ``horizons`` up to `headline_steps`, else the shortest; None without any."""
    near = [horizon for horizon in horizons if horizon <= headline_steps(dt)]
    return max(near) if near else min(horizons, default=None)


@dataclass(frozen=True)
class MeasuredCases:
    """Test cases of prediction, the same for every model.

    ``moving`` (N, H) marks the targets of the ``windows`` that count; ``window_block`` (N,) numbers the bootstrap
    blocks. ``horizons`` are those of the protocol that fit into the episodes. ``std`` and ``rms`` (nx,) are those of
    the measured moving samples of the test set, of a periodic state the shortest way round. ``guard`` (2, nx) are the
    limits to which predictions are clipped. ``notes`` list omissions; ``test`` is the whole test set.
    """

    system: System
    test: Dataset
    protocol: PredictionProtocol
    horizons: tuple[int, ...]
    windows: Windows
    moving: BoolArray
    window_block: IntArray
    free_runs: tuple[FreeRun, ...]
    std: Array
    rms: Array
    guard: Array
    notes: tuple[str, ...]

    @property
    def main_horizon(self) -> int | None:
        """The horizon at which errors are reported, in steps, see `main_horizon`; None without any."""
        return main_horizon(self.horizons, self.system.dt)

    def blocks(self, horizon: int | None) -> int:
        """Return the number of bootstrap blocks with errors after ``horizon`` steps, or in simulation (None)."""
        if horizon is not None:
            return len(np.unique(self.window_block[self.moving[:, horizon - 1]]))
        size = self.protocol.block_samples
        return sum(len(np.unique(np.flatnonzero(run.moving) // size)) for run in self.free_runs)

    @property
    def near_horizon(self) -> int | None:
        """A quarter of the main horizon, in steps: a window is still near its start then."""
        return None if self.main_horizon is None else max(1, round(self.main_horizon / 4))

    @property
    def scale(self) -> Array:
        """Divisor of errors, (nx,): ``std``, NaN for a state that is constant in the test set."""
        return np.where(self.std > 0, self.std, np.nan)

    def n_of_sums(self, sums: Array) -> Array:
        """Return N (R, K) from sums of squared errors and their number, (R, K * (nx + 1)); NaN without errors."""
        parts = sums.reshape(len(sums), -1, self.system.nx + 1)
        squares, counts = parts[..., :-1], parts[..., -1:]
        mean = np.divide(squares, counts, out=np.full_like(squares, np.nan), where=counts > 0)
        return mean_over_channels(np.sqrt(mean) / self.scale)

    def history(self, lags: int) -> tuple[Array, Array]:
        """Return states (N, lags + 1, nx) and controls (N, lags, nu) before the windows, see `before`."""
        states = np.empty((len(self.windows), lags + 1, self.system.nx))
        controls = np.empty((len(self.windows), lags, self.system.nu))
        for number, episode in enumerate(self.test.episodes):
            rows = self.windows.episode == number
            states[rows], controls[rows] = self.before(episode, self.windows.start[rows], lags)
        return states, controls

    def before(self, episode: Trajectory, starts: IntArray, lags: int) -> tuple[Array, Array]:
        """Return ``lags`` samples before each of the ``starts`` (N,); missing ones are padded.

        Samples are missing before the start of the record, or if they are older than the protocol's ``history``. They
        are padded with the first state and neutral controls.
        """
        given = starts if self.protocol.history is None else np.minimum(starts, self.protocol.history)
        places = starts[:, None] + np.arange(-lags, 1)
        oldest = (starts - given)[:, None]
        controls = episode.controls[np.maximum(places[:, :-1], 0)]
        made_up = (places[:, :-1] < oldest)[:, :, None]
        return episode.states[np.maximum(places, oldest)], np.where(made_up, self.system.neutral_control, controls)


@dataclass(frozen=True)
class FreeRun:
    """One episode from sample ``first`` to its end: H steps, and which targets move (H,)."""

    episode: str
    controls: Array
    states: Array
    moving: BoolArray


def measured_cases(training: Dataset, test: Dataset, protocol: PredictionProtocol) -> MeasuredCases:
    """Divide ``test`` into windows and whole episodes; ``training`` gives the guard only.

    A horizon longer than every episode is left out with a note. Raises `InvalidData` if nothing in the test set moves,
    or if its system is another one.
    """
    if training.system != test.system:
        raise InvalidData("prediction: training and test set must have the same system, got two different ones")
    system, protocol = test.system, protocol.at(test.system.dt)
    notes = []
    windows, horizons = _windows(test, protocol)
    ahead = windows.start[:, None] + 1 + np.arange(windows.states.shape[1])
    begins = np.cumsum([0, *(len(rows) for rows in test.moving)])
    moving = np.concatenate(test.moving)[begins[windows.episode][:, None] + ahead]
    horizons = tuple(horizon for horizon in horizons if moving[:, horizon - 1].any())
    left_out = [horizon for horizon in protocol.horizons if horizon not in horizons]
    if left_out:
        longest = max(len(episode) for episode in test.episodes) - protocol.first
        notes.append(
            f"horizon {few(list(map(str, left_out)), MOST_LISTED)} left out: no moving test window has that length "
            f"(the longest episode leaves {max(longest, 0)} steps after sample {protocol.first})"
        )
    truth = np.concatenate([e.states[rows] for e, rows in zip(test.episodes, test.moving, strict=True)])
    if not len(truth):
        raise InvalidData("prediction: nothing moves in the test set; hold out an episode with motion")
    std, rms = spread_of(system, truth), np.sqrt(np.mean(system.wrap(truth) ** 2, axis=0))
    constant = [channel.name for channel, size in zip(system.states, std, strict=True) if size == 0]
    if constant:
        notes.append(f"{few(constant, MOST_LISTED)} is constant in the test set and left out of N")
    short = [episode.name for episode in test.episodes if len(episode) <= protocol.first]
    if short:
        notes.append(
            f"no simulation of whole episode {few(short, MOST_LISTED)}: shorter than {protocol.first + 1} steps"
        )
    return MeasuredCases(
        system=system,
        test=test,
        protocol=protocol,
        horizons=horizons,
        windows=windows,
        moving=moving,
        window_block=_window_blocks(windows, protocol.block_windows),
        free_runs=_free_runs(test, protocol),
        std=std,
        rms=rms,
        guard=_guard(training, protocol.guard_multiple),
        notes=tuple(notes),
    )


def _windows(test: Dataset, protocol: PredictionProtocol) -> tuple[Windows, tuple[int, ...]]:
    """Return windows of the longest horizon that fits into any episode."""
    for count in range(len(protocol.horizons), 0, -1):
        windows = test.windows(
            protocol.horizons[count - 1],
            stride=protocol.stride,
            history=protocol.given,
            first=protocol.first,
            moving=True,
        )
        if len(windows):
            return windows, protocol.horizons[:count]
    return windows, ()


def _window_blocks(windows: Windows, size: int) -> IntArray:
    """Number blocks of ``size`` consecutive windows; no block crosses an episode."""
    _, first, count = np.unique(windows.episode, return_index=True, return_counts=True)
    begins = np.cumsum([0, *-(-count // size)])[:-1]
    return np.repeat(begins, count) + (np.arange(len(windows)) - np.repeat(first, count)) // size


def _free_runs(test: Dataset, protocol: PredictionProtocol) -> tuple[FreeRun, ...]:
    first = protocol.first
    return tuple(
        FreeRun(
            episode=episode.name,
            controls=episode.controls[first:],
            states=episode.states[first + 1 :],
            moving=rows[first + 1 :],
        )
        for episode, rows in zip(test.episodes, test.moving, strict=True)
        if len(episode) > first
    )


def _guard(training: Dataset, multiple: float) -> Array:
    states = np.concatenate([e.states[rows] for e, rows in zip(training.episodes, training.moving, strict=True)])
    if not len(states):
        raise InvalidData("prediction: nothing moves in the training set")
    limit = multiple * np.abs(states).max(axis=0)
    limit = np.where(limit > 0, limit, np.inf)
    limit[list(training.system.periods)] = np.inf
    return np.stack([-limit, limit])


def spread_of(system: System, states: Array) -> Array:
    """Return the standard deviation (nx,) of ``states`` (N, nx), 0 if constant except for rounding."""
    spread, size = system.spread(states), np.sqrt(np.mean(system.wrap(states) ** 2, axis=0))
    return np.where(spread > ROUNDING * size, spread, 0.0)


ROUNDING = 1e-12
"""Relative spread up to which a state is constant: some thousand times the rounding of one number."""

MOST_LISTED = 6
"""Maximum number of names in a note; of the others the number is given."""
