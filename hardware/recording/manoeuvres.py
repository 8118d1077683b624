"""Scripted manoeuvres: excitation of driving robots, signals for any system."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import chain
from typing import TypeAlias

import numpy as np

from sysid_evo.errors import InvalidArgument
from sysid_evo.system import Channel, System
from sysid_evo.types import Array, check_shape


@dataclass(frozen=True)
class Manoeuvre:
    """A named sequence of controls (T, nu), one for each ``dt`` of the system."""

    name: str
    controls: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "controls", check_shape(f"controls of {self.name!r}", self.controls, (None, None)))


Segment: TypeAlias = tuple[Array, float]
"""A control (nu,) and the time in s for which it is held."""

DURATION = 360.0  # s: "about 6 minutes of driving data"
ROUND = 300
"""Approximate number of samples of each manoeuvre of a system without a motion; rounds are repeated to fit."""
SHORTEST = 1.0  # s: the shortest manoeuvre that is recorded
LEAD = 0.5  # s without a command at the start, so that preparation, which cuts the ends, does not cut the launch
HOLDS = (0.1, 0.2, 0.4, 0.8, 1.6)  # s: mean time between random switches, from faster than the car to slower


def excitation_manoeuvres(system: System, *, duration: float = DURATION, rng: np.random.Generator) -> list[Manoeuvre]:
    """Return manoeuvres of equal length, ``duration`` s in all, each with half a second of rest first.

    A system without a motion gets `signal_scripts`, in rounds of about `ROUND` samples each. A system with a motion
    gets twelve manoeuvres that cover its driving without racing (paper, section 3): the first control counts as the
    drive, the last as the steering; controls between them move in the random manoeuvres only. A continuous control uses
    its two limits and its neutral value. Manoeuvres that need a missing control (steering, driving backward) are left
    out. Raises `InvalidArgument`.
    """
    scripts = _driving(system, rng) if system.motion is not None else _rounds(system, duration, rng)
    each = duration / len(scripts)
    if each < SHORTEST:
        raise InvalidArgument(
            f"excitation: expected at least {SHORTEST * len(scripts):.0f} s for {len(scripts)} manoeuvres, "
            f"got {duration} s"
        )
    steps = round(each / system.dt)
    rest: Segment = (system.neutral_control, LEAD)
    return [Manoeuvre(name, _sample(chain([rest], script), steps, system.dt)) for name, script in scripts.items()]


def _rounds(system: System, duration: float, rng: np.random.Generator) -> dict[str, Iterator[Segment]]:
    """Return the signals as often as there is time for, numbered from the second round."""
    scripts = signal_scripts(system, rng)
    rounds = round(duration / (len(scripts) * ROUND * system.dt))
    for number in range(2, rounds + 1):
        scripts |= {f"{name}-{number}": script for name, script in signal_scripts(system, rng).items()}
    return scripts


def _driving(system: System, rng: np.random.Generator) -> dict[str, Iterator[Segment]]:
    """Return an endless script for each manoeuvre, each with its own random numbers."""
    ends = _speeds(system)
    scripts: dict[str, Iterator[Segment]] = {}

    def own() -> np.random.Generator:
        return rng.spawn(1)[0]

    if system.nu > 1:
        for way, propel in zip(("forward", "backward"), ends, strict=False):
            scripts[f"loops-{way}"] = _loop(system, propel, own())
            scripts[f"figure-8-{way}"] = _figure_8(system, propel, own())
        scripts["weaving"] = _weave(system, own())
    scripts["starts-and-stops"] = _start_and_stop(system, own())
    if len(ends) > 1:
        scripts["reversals"] = _reverse(system, own())
    for mean in HOLDS:
        scripts[f"random-{mean:g}"] = switches(system, mean, own())
    return scripts


def _speeds(system: System) -> list[float]:
    """Return full speed forward and, if the system allows it, backward."""
    high, low = extremes(system.controls[0])[[-1, 0]].tolist()
    return [high] if low == system.controls[0].neutral else [high, low]


def _command(system: System, propel: float, steer: float | None = None) -> Array:
    control = system.neutral_control.copy()
    if steer is not None and system.nu > 1:
        control[-1] = steer
    control[0] = propel
    return control


def _shuffled(values: Array, rng: np.random.Generator) -> Iterator[float]:
    """Yield all values in random order, endlessly."""
    while True:
        yield from rng.permutation(values).tolist()


def _loop(system: System, propel: float, rng: np.random.Generator) -> Iterator[Segment]:
    """Full speed, a few circles to one side, a straight, a few circles to the other."""
    limits = extremes(system.controls[-1])[[-1, 0]].tolist()
    while True:
        for steer in limits:
            yield _command(system, propel, steer), rng.uniform(3.0, 6.0)
            yield _command(system, propel), rng.uniform(1.0, 3.0)


def _figure_8(system: System, propel: float, rng: np.random.Generator) -> Iterator[Segment]:
    """Full speed, steering from one limit to the other about once a circle."""
    limits = extremes(system.controls[-1])[[-1, 0]].tolist()
    while True:
        for steer in limits:
            yield _command(system, propel, steer), rng.uniform(1.8, 2.8)


def _weave(system: System, rng: np.random.Generator) -> Iterator[Segment]:
    """Full speed and short steering pulses, forward and backward in turn."""
    steers = _shuffled(extremes(system.controls[-1]), rng)
    while True:
        for propel in _speeds(system):
            for _ in range(10):
                yield _command(system, propel, next(steers)), rng.uniform(0.15, 0.7)


def _start_and_stop(system: System, rng: np.random.Generator) -> Iterator[Segment]:
    """Launches in either direction, then coasting to rest, with every steering."""
    steers = _shuffled(extremes(system.controls[-1]), rng)
    while True:
        for propel in _speeds(system):
            steer = next(steers)
            yield _command(system, propel, steer), rng.uniform(0.3, 2.0)
            yield _command(system, float(system.neutral_control[0]), steer), rng.uniform(0.5, 2.5)


def _reverse(system: System, rng: np.random.Generator) -> Iterator[Segment]:
    """From full speed in one direction to full speed in the other, with every steering."""
    steers = _shuffled(extremes(system.controls[-1]), rng)
    while True:
        for propel in _speeds(system):
            yield _command(system, propel, next(steers)), rng.uniform(0.5, 2.0)


def _sample(segments: Iterator[Segment], steps: int, dt: float) -> Array:
    """Return the controls (steps, nu) in force at the start of each step."""
    rows: list[Array] = []
    control, end = next(segments)
    for step in range(steps):
        while end <= step * dt:
            control, hold = next(segments)
            end += hold
        rows.append(control)
    return np.array(rows)


STEP_HOLDS = (3, 10, 30, 100)
"""Mean time between random steps, in samples."""
SWITCH_HOLDS = (5, 15, 45)
"""Mean time between random switches from one limit to the other, in samples."""
FASTEST, SLOWEST = 6, 150
"""Periods between which a sine sweeps, in samples."""
SWEEP = 280
"""Samples of the sweeps of all controls, one after the other; then they are repeated."""


def signal_scripts(system: System, rng: np.random.Generator) -> dict[str, Iterator[Segment]]:
    """Return an endless script for each signal, for systems without a motion; each has its own random numbers."""
    scripts: dict[str, Iterator[Segment]] = {}
    for mean in STEP_HOLDS:
        scripts[f"steps-{mean * system.dt:g}"] = steps(system, mean * system.dt, rng.spawn(1)[0])
    for mean in SWITCH_HOLDS:
        scripts[f"switches-{mean * system.dt:g}"] = switches(system, mean * system.dt, rng.spawn(1)[0])
    scripts["sweep-to-fast"] = sweep(system, SLOWEST, FASTEST)
    scripts["sweep-to-slow"] = sweep(system, FASTEST, SLOWEST)
    return scripts


def extremes(channel: Channel) -> Array:
    """Return the levels of a control, or its two limits and its neutral value, in rising order."""
    if channel.levels is not None:
        return np.array(channel.levels)
    if not channel.bounded:
        raise InvalidArgument(
            f"excitation: control {channel.name!r} has no finite limits: give it low and high, or levels"
        )
    return np.unique([channel.low, channel.neutral, channel.high])


def switches(system: System, mean: float, rng: np.random.Generator) -> Iterator[Segment]:
    """Every control jumps to a random extreme at random times, ``mean`` s apart, independently."""
    levels = [extremes(channel) for channel in system.controls]
    return _jumps(system.nu, lambda control: float(rng.choice(levels[control])), mean, rng)


def steps(system: System, mean: float, rng: np.random.Generator) -> Iterator[Segment]:
    """Every control jumps to a random value within its limits at random times, ``mean`` s apart, independently."""
    levels = [extremes(channel) for channel in system.controls]

    def draw(control: int) -> float:
        return _legal(system.controls[control], rng.uniform(levels[control][0], levels[control][-1]))

    return _jumps(system.nu, draw, mean, rng)


def sweep(system: System, first: float, last: float) -> Iterator[Segment]:
    """Each control in turn follows a sine over its limits, with a period from ``first`` to ``last`` samples."""
    ends = [extremes(channel)[[0, -1]].tolist() for channel in system.controls]
    each = SWEEP // system.nu
    while True:
        for number, (low, high) in enumerate(ends):
            phase = 0.0
            for sample in range(each):
                control = system.neutral_control.copy()
                share = 0.5 + 0.5 * math.sin(phase)
                control[number] = _legal(system.controls[number], low + share * (high - low))
                yield control, system.dt
                phase += 2.0 * math.pi / (first * (last / first) ** (sample / each))


def _jumps(nu: int, draw: Callable[[int], float], mean: float, rng: np.random.Generator) -> Iterator[Segment]:
    control = np.array([draw(i) for i in range(nu)])
    due = rng.exponential(mean, nu)
    now = 0.0
    while True:
        channel = int(np.argmin(due))
        yield control.copy(), float(due[channel]) - now
        now = float(due[channel])
        control[channel] = draw(channel)
        due[channel] += rng.exponential(mean)


def _legal(channel: Channel, value: float) -> float:
    """Return ``value``, or the nearest level of a discrete control."""
    if channel.levels is None:
        return value
    return min(channel.levels, key=lambda level: abs(level - value))
