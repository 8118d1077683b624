"""What a recording is good for: how the robot was excited, where it has been, what to record next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import scipy

from sysid_evo.arrays import Array, IntArray
from sysid_evo.data.dataset import Dataset
from sysid_evo.data.delays import Delay, find_delays
from sysid_evo.data.raw import RawLog
from sysid_evo.system import Channel

LEVELS = 3
"""Levels that a continuous control is counted by: each value belongs to the nearest."""

CELLS = 8
"""Cells along each state over its visited range."""

MOST_COMMANDS = 81
"""Combinations of levels listed in full; of more, only those that occur."""

BAND_SHARE = 0.95
"""Share of the power of a signal that lies within its bandwidth."""

ENOUGH_TIME = 360.0  # s in motion; the paper used about six minutes
RARE = 0.02  # share of time
RARE_TOGETHER = 0.01  # share of time
IDLE = 0.3  # share of time
SWITCHES = 20.0  # a minute
NOISY_BAND = 0.6  # share of half the control rate
JITTER = 0.1  # share of a step


@dataclass(frozen=True)
class ControlUse:
    """How often each level of a control was used; ``shares`` add up to 1, ``switches`` change the level."""

    name: str
    unit: str
    levels: tuple[float, ...]
    shares: tuple[float, ...]
    switches: int
    per_minute: float


@dataclass(frozen=True)
class StateUse:
    """Root mean square and range of a state, and the frequency (Hz) below which 95 % of its power lies."""

    name: str
    unit: str
    rms: float
    low: float
    high: float
    bandwidth: float


@dataclass(frozen=True)
class CommandUse:
    """One combination of levels: its share of time, and of the visited state cells where it was tried."""

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


@dataclass(frozen=True)
class Advice:
    """What `advise` found.

    ``duration`` and ``dt`` are in s, ``moving`` is the share of samples not in a standstill,
    ``cells`` how many of the ``grid`` cells of the visited state space were visited, ``sampling``
    is empty unless the logs were given; ``suggestions`` say in sentences what to do.
    """

    episodes: int
    duration: float
    dt: float
    moving: float
    controls: tuple[ControlUse, ...]
    states: tuple[StateUse, ...]
    cells: int
    grid: int
    commands: tuple[CommandUse, ...]
    delays: tuple[Delay, ...]
    sampling: tuple[Sampling, ...]
    suggestions: tuple[str, ...]


def advise(dataset: Dataset, logs: Sequence[RawLog] = ()) -> Advice:
    """Look at excitation, coverage, sampling (of ``logs``, if given) and delays of ``dataset``."""
    system = dataset.system
    controls = np.concatenate([episode.controls for episode in dataset])
    states = np.concatenate([episode.states[:-1] for episode in dataset])
    moving = float(np.mean(np.concatenate(dataset.moving)))
    levels = [_levels(channel, controls[:, i]) for i, channel in enumerate(system.controls)]
    level = [_nearest(values, controls[:, i]) for i, values in enumerate(levels)]
    starts = np.cumsum([0, *(len(episode) for episode in dataset)])[1:-1]
    uses = tuple(
        _control_use(channel, values, index, starts, dataset.duration)
        for channel, values, index in zip(system.controls, levels, level, strict=True)
    )
    cell = _cells(states)
    visited = len(np.unique(cell))
    combinations = list(product(*(range(len(use.levels)) for use in uses)))
    if len(combinations) > MOST_COMMANDS:
        combinations = sorted(set(zip(*(index.tolist() for index in level), strict=True)))
    advice = Advice(
        episodes=len(dataset),
        duration=dataset.duration,
        dt=system.dt,
        moving=moving,
        controls=uses,
        states=tuple(_state_use(dataset, i) for i in range(system.nx)),
        cells=visited,
        grid=CELLS**system.nx,
        commands=tuple(_command_use(levels, numbers, level, cell, visited) for numbers in combinations),
        delays=find_delays(dataset),
        sampling=tuple(_sampling(log) for log in logs),
        suggestions=(),
    )
    return replace(advice, suggestions=tuple(_suggestions(advice)))


def _levels(channel: Channel, values: Array) -> tuple[float, ...]:
    """Return the levels to count by; a missing limit is the recorded one."""
    if channel.levels is not None:
        return channel.levels
    low = channel.low if np.isfinite(channel.low) else values.min()
    high = channel.high if np.isfinite(channel.high) else values.max()
    return tuple(float(value) for value in np.linspace(low, high, LEVELS)) if low < high else (float(low),)


def _nearest(levels: Sequence[float], values: Array) -> IntArray:
    return np.abs(values[:, None] - np.asarray(levels)).argmin(axis=1)


def _control_use(
    channel: Channel, levels: tuple[float, ...], index: IntArray, starts: IntArray, duration: float
) -> ControlUse:
    changes = np.diff(index) != 0
    changes[starts - 1] = False
    shares = np.bincount(index, minlength=len(levels)) / len(index)
    switches = int(changes.sum())
    return ControlUse(channel.name, channel.unit, levels, tuple(shares.tolist()), switches, 60.0 * switches / duration)


def _state_use(dataset: Dataset, i: int) -> StateUse:
    channel = dataset.system.states[i]
    values = np.concatenate([episode.states[:, i] for episode in dataset])
    return StateUse(
        channel.name,
        channel.unit,
        rms=float(np.sqrt(np.mean(values**2))),
        low=float(values.min()),
        high=float(values.max()),
        bandwidth=_bandwidth([episode.states[:, i] for episode in dataset], 1.0 / dataset.system.dt),
    )


def _bandwidth(series: Sequence[Array], rate: float) -> float:
    """Return the frequency below which 95 % of the power lies (Welch, segments of the same length), in Hz."""
    segment = min(256, max(len(s) for s in series))
    power = np.zeros(segment // 2 + 1)
    frequency = np.fft.rfftfreq(segment, 1.0 / rate)
    for s in series:
        if len(s) >= segment:
            power += len(s) * scipy.signal.welch(s, fs=rate, nperseg=segment)[1]
    total = np.cumsum(power)
    return float(frequency[np.searchsorted(total, BAND_SHARE * total[-1])]) if total[-1] > 0.0 else 0.0


def _cells(states: Array) -> IntArray:
    """Return the number of the grid cell of each state (N,)."""
    low, span = states.min(axis=0), np.ptp(states, axis=0)
    place = np.minimum((states - low) / np.where(span > 0.0, span, 1.0) * CELLS, CELLS - 1).astype(np.int64)
    return np.unique(place, axis=0, return_inverse=True)[1].reshape(-1)


def _command_use(
    levels: Sequence[Sequence[float]],
    numbers: tuple[int, ...],
    level: Sequence[IntArray],
    cell: IntArray,
    visited: int,
) -> CommandUse:
    here = np.ones(len(cell), dtype=bool)
    for number, index in zip(numbers, level, strict=True):
        here &= index == number
    values = tuple(of_control[number] for of_control, number in zip(levels, numbers, strict=True))
    return CommandUse(values, float(here.mean()), len(np.unique(cell[here])) / visited)


def _sampling(log: RawLog) -> Sampling:
    steps = np.diff(log.time)
    median = float(np.median(steps))
    regular = steps[steps < 1.5 * median]
    return Sampling(
        log.name, len(log.time), float(steps.min()), median, float(steps.max()), scatter=float(regular.std())
    )


def _suggestions(advice: Advice) -> list[str]:
    found = []
    driven = advice.duration * advice.moving
    if driven < ENOUGH_TIME:
        found.append(
            f"{driven / 60:.1f} min in motion is less than the {ENOUGH_TIME / 60:.0f} min usual for a car: record more."
        )
    if advice.moving < 1.0 - IDLE:
        found.append(
            f"The robot stands still {1.0 - advice.moving:.0%} of the time: leave such windows out when you score."
        )
    found += [sentence for use in advice.controls for sentence in _about_control(use)]
    never = [command.levels for command in advice.commands if command.share < RARE_TOGETHER]
    if never and len(advice.controls) > 1:
        names = ", ".join(use.name for use in advice.controls)
        listed = "; ".join(", ".join(f"{level:.3g}" for level in levels) for levels in never)
        found.append(f"Less than {RARE_TOGETHER:.0%} of the time at ({names}) near: {listed}.")
    for use in advice.controls:
        clear = [delay for delay in advice.delays if delay.control == use.name and delay.clear]
        if clear:
            found += _about_delay(max(clear, key=lambda delay: abs(delay.strength)))
    half = 0.5 / advice.dt
    found += [
        f"95 % of {use.name} lies below {use.bandwidth:.1f} Hz, close to half the control rate ({half:g} Hz): "
        "it is noisy, or dt is too long."
        for use in advice.states
        if use.bandwidth > NOISY_BAND * half
    ]
    found += [
        f"The time stamps of {log.name} scatter by {log.scatter / log.median:.0%} of a step."
        for log in advice.sampling
        if log.scatter > JITTER * log.median
    ]
    return found


def _about_control(use: ControlUse) -> list[str]:
    found = []
    rare = [f"{level:.3g}" for level, share in zip(use.levels, use.shares, strict=True) if share < RARE]
    if rare:
        found.append(f"{use.name} is near {', '.join(rare)} less than {RARE:.0%} of the time: models will guess there.")
    if use.per_minute < SWITCHES:
        found.append(
            f"{use.name} changes its level only {use.per_minute:.0f} times a minute: switch more often, "
            "so that the response to a change is in the data."
        )
    return found


def _about_delay(delay: Delay) -> list[str]:
    ms = 1e3 * delay.seconds
    if delay.steps < 0:
        return [
            f"{delay.state} moves {-ms:.0f} ms before {delay.control} is logged: commands are stamped late, "
            "or something fast feeds the state back."
        ]
    if delay.steps > 0:
        return [
            f"{delay.state} answers {delay.control} most {ms:.0f} ms later: "
            f"give the models control_lags of {delay.steps} or more."
        ]
    return []
