"""Quality of a recording: excitation, coverage, sampling, delays."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from sysid_evo.data.dataset import Dataset
from sysid_evo.data.preparation import RawLog
from sysid_evo.data.response import LATEST_STEPS, Delay, find_delays, fit_linear
from sysid_evo.data.usable import check_usable
from sysid_evo.errors import InvalidData
from sysid_evo.system import Channel
from sysid_evo.types import Array, IntArray

LEVELS = 3
"""Number of levels to which values of a continuous control are rounded for counting."""

CELLS = 8
"""Number of cells along each state over its visited range."""

MOST_COMMANDS = 81
"""Largest number of combinations of levels to list in full; of more, only those that occur are listed."""

BAND_SHARE = 0.95
"""Share of the power of a signal that lies within its bandwidth."""

MIN_MOVING_SHARE, REST_RANGE_SHARE, FEWEST = 0.1, 0.01, 10
"""An episode is idle if less than the first share of its time is in motion, or if every state stays within the second
share of its range over all episodes. Episodes of fewer steps are never called idle."""


@dataclass(frozen=True)
class ControlUse:
    """Shares of time of each level of a control, which add up to 1, and the number of ``switches`` between levels."""

    name: str
    unit: str
    levels: tuple[float, ...]
    shares: tuple[float, ...]
    switches: int
    per_minute: float


@dataclass(frozen=True)
class StateUse:
    """Excitation of a state: root mean square, range (for a periodic one within a turn), bandwidth, explained variance.

    ``bandwidth`` is the frequency in Hz below which 95 % of its power lies, ``explained`` the share of its
    variance that the sample before and the controls explain (`fit_linear`).
    """

    name: str
    unit: str
    rms: float
    low: float
    high: float
    bandwidth: float
    explained: float


@dataclass(frozen=True)
class CommandUse:
    """One combination of levels: its share of time, and the share of visited state cells in which it occurred."""

    levels: tuple[float, ...]
    share: float
    coverage: float


@dataclass(frozen=True)
class Sampling:
    """The steps between the rows of one log, in s."""

    name: str
    rows: int
    shortest: float
    median: float
    longest: float
    scatter: float

    @classmethod
    def of(cls, log: RawLog) -> Sampling:
        steps = np.diff(log.time)
        median = float(np.median(steps))
        scatter = float(steps[steps < 1.5 * median].std())
        return cls(log.name, len(log.time), float(steps.min()), median, float(steps.max()), scatter)


@dataclass(frozen=True)
class RecordingQuality:
    """Information content of a recording for model fitting, see `recording_quality`.

    - ``duration``, ``dt``: in s.
    - ``moving``: share of samples that are not in a standstill; ``idle``: names of the episodes without motion.
    - ``scales``: time constants of the system in s (`fit_linear`).
    - ``unusable``: the reason why the data are not sufficient, or "".
    - ``cells``: number of visited cells, of the ``grid`` cells of the range of the states.
    - ``sampling``: empty unless the logs were given.
    """

    episodes: int
    duration: float
    dt: float
    moving: float
    idle: tuple[str, ...]
    scales: tuple[float, ...]
    unusable: str
    controls: tuple[ControlUse, ...]
    states: tuple[StateUse, ...]
    cells: int
    grid: int
    commands: tuple[CommandUse, ...]
    delays: tuple[Delay, ...]
    sampling: tuple[Sampling, ...]


def recording_quality(dataset: Dataset, logs: Sequence[RawLog] = ()) -> RecordingQuality:
    """Return excitation, coverage, sampling (of ``logs``, if given) and delays of ``dataset``."""
    system = dataset.system
    controls = np.concatenate([episode.controls for episode in dataset])
    states = np.concatenate([episode.states[:-1] for episode in dataset])
    moving = float(np.mean(np.concatenate(dataset.moving)))
    levels = [_levels(channel, controls[:, i]) for i, channel in enumerate(system.controls)]
    level = [np.abs(controls[:, [i]] - np.asarray(values)).argmin(axis=1) for i, values in enumerate(levels)]
    starts = np.cumsum([0, *(len(episode) for episode in dataset)])[1:-1]
    uses = []
    for channel, values, index in zip(system.controls, levels, level, strict=True):
        changes = np.diff(index) != 0
        changes[starts - 1] = False
        shares = np.bincount(index, minlength=len(values)) / len(index)
        switches = int(changes.sum())
        per_minute = 60.0 * switches / dataset.duration
        uses.append(ControlUse(channel.name, channel.unit, values, tuple(shares.tolist()), switches, per_minute))
    cell = _cells(system.wrap(states))
    visited = int(cell.max()) + 1
    fit = fit_linear(dataset, LATEST_STEPS)
    explained = np.ones(system.nx) if fit is None else fit.explained
    return RecordingQuality(
        episodes=len(dataset),
        duration=dataset.duration,
        dt=system.dt,
        moving=moving,
        idle=_idle(dataset),
        scales=() if fit is None else fit.scales,
        unusable=_unusable(dataset),
        controls=tuple(uses),
        states=tuple(_state_use(dataset, i, float(explained[i])) for i in range(system.nx)),
        cells=visited,
        grid=CELLS**system.nx,
        commands=tuple(_command_uses(levels, level, cell)),
        delays=find_delays(dataset),
        sampling=tuple(map(Sampling.of, logs)),
    )


def _idle(dataset: Dataset) -> tuple[str, ...]:
    """Return the names of the episodes without motion."""
    lowest = np.min([episode.states.min(axis=0) for episode in dataset], axis=0)
    highest = np.max([episode.states.max(axis=0) for episode in dataset], axis=0)
    rest_range = REST_RANGE_SHARE * (highest - lowest)
    return tuple(
        episode.name
        for episode, moving in zip(dataset, dataset.moving, strict=True)
        if len(episode) >= FEWEST
        and (moving.mean() < MIN_MOVING_SHARE or (np.ptp(episode.states, axis=0) <= rest_range).all())
    )


def _unusable(dataset: Dataset) -> str:
    try:
        check_usable(dataset)
    except InvalidData as error:
        return f"{error}."
    return ""


def _levels(channel: Channel, values: Array) -> tuple[float, ...]:
    """Return the levels for counting; missing limits are replaced by the recorded ones."""
    if channel.levels is not None:
        return channel.levels
    low = channel.low if np.isfinite(channel.low) else values.min()
    high = channel.high if np.isfinite(channel.high) else values.max()
    return tuple(float(value) for value in np.linspace(low, high, LEVELS)) if low < high else (float(low),)


def _state_use(dataset: Dataset, i: int, explained: float) -> StateUse:
    channel = dataset.system.states[i]
    values = np.concatenate([dataset.system.wrap(episode.states)[:, i] for episode in dataset])
    return StateUse(
        channel.name,
        channel.unit,
        rms=float(np.sqrt(np.mean(values**2))),
        low=float(values.min()),
        high=float(values.max()),
        bandwidth=_bandwidth([episode.states[:, i] for episode in dataset], 1.0 / dataset.system.dt),
        explained=explained,
    )


def _bandwidth(series: Sequence[Array], rate: float) -> float:
    """Return the frequency below which 95 % of the power lies (Welch, segments of the same length), in Hz.

    Segments of up to 256 samples overlap by half and have a Hann window; their mean is removed.
    """
    segment = min(256, max(len(s) for s in series))
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(segment) / segment)
    sides = np.full(segment // 2 + 1, 2.0)  # every frequency but the mean and half the rate has a negative twin
    sides[:: segment // 2 if segment % 2 == 0 else segment] = 1.0
    power = np.zeros(segment // 2 + 1)
    for s in series:
        if len(s) >= segment:
            segments = sliding_window_view(s, segment)[:: segment - segment // 2]
            spectra = np.abs(np.fft.rfft((segments - segments.mean(axis=1, keepdims=True)) * window)) ** 2
            power += len(s) * sides * spectra.mean(axis=0)
    total = np.cumsum(power)
    frequency = np.fft.rfftfreq(segment, 1.0 / rate)
    return float(frequency[np.searchsorted(total, BAND_SHARE * total[-1])]) if total[-1] > 0.0 else 0.0


def _cells(states: Array) -> IntArray:
    """Return the number of the grid cell of each state (N,), numbered among the visited cells."""
    low, span = states.min(axis=0), np.ptp(states, axis=0)
    place = np.minimum((states - low) / np.where(span > 0.0, span, 1.0) * CELLS, CELLS - 1).astype(np.int64)
    return _numbered([(column, CELLS) for column in place.T])


def _numbered(columns: Iterable[tuple[IntArray, int]]) -> IntArray:
    """Return the number (N,) of each row among the distinct rows; each column (N,) comes with its number of values."""
    number = np.zeros(1, dtype=np.int64)
    for column, size in columns:
        number = np.unique(number * size + column, return_inverse=True)[1].reshape(-1)
    return number


def _command_uses(
    levels: Sequence[tuple[float, ...]], level: Sequence[IntArray], cell: IntArray
) -> Iterator[CommandUse]:
    """Yield the use of every combination of levels; of more than `MOST_COMMANDS`, only of those that occur."""
    sizes, visited = [len(of_control) for of_control in levels], int(cell.max()) + 1
    used = _numbered(zip(level, sizes, strict=True)) if levels else np.zeros_like(cell)
    _, first, count = np.unique(used, return_index=True, return_counts=True)
    tried = np.bincount(np.unique(used * visited + cell) // visited)
    found = {
        tuple(int(index[row]) for index in level): (float(steps / len(cell)), int(cells))
        for row, steps, cells in zip(first, count, tried, strict=True)
    }
    if math.prod(sizes) <= MOST_COMMANDS:
        found = {numbers: found.get(numbers, (0.0, 0)) for numbers in product(*map(range, sizes))}
    for numbers, (share, cells) in found.items():
        values = tuple(of_control[number] for of_control, number in zip(levels, numbers, strict=True))
        yield CommandUse(values, share, cells / visited)
