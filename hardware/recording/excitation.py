"""Scripted manoeuvres that span the driving envelope without racing (paper, section 3)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain

import numpy as np

from sysid_evo.arrays import Array, check_shape
from sysid_evo.errors import InvalidArgument
from sysid_evo.system import Channel, System

DURATION = 360.0  # s: "about 6 minutes of driving data"
SHORTEST = 1.0  # s that a manoeuvre must last to be worth a recording
LEAD = 0.5  # s without a command at the start, so that preparation, which cuts the ends, leaves the launch in
HOLDS = (0.1, 0.2, 0.4, 0.8, 1.6)  # s: mean time between random switches, from faster than the car to slower

Segment = tuple[Array, float]
"""A control (nu,) and how long to hold it, in s."""


@dataclass(frozen=True)
class Manoeuvre:
    """A named sequence of controls (T, nu), one for each ``dt`` of the system."""

    name: str
    controls: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "controls", check_shape(f"controls of {self.name!r}", self.controls, (None, None)))


def excitation(system: System, *, duration: float = DURATION, rng: np.random.Generator) -> list[Manoeuvre]:
    """Return twelve manoeuvres of equal length, ``duration`` s in all, each with half a second of rest first.

    The first control is taken for the one that propels, the last for the one that steers; controls
    between them move in the random manoeuvres only. A continuous control uses its two limits and
    its neutral value. Manoeuvres for which a system has no control (steering, driving backward)
    are left out. Raises `InvalidArgument`.
    """
    scripts = _scripts(system, rng)
    each = duration / len(scripts)
    if each < SHORTEST:
        raise InvalidArgument(
            f"excitation: expected at least {SHORTEST * len(scripts):.0f} s for {len(scripts)} manoeuvres, "
            f"got {duration} s"
        )
    steps = round(each / system.dt)
    rest: Segment = (system.neutral_control, LEAD)
    return [Manoeuvre(name, _sample(chain([rest], script), steps, system.dt)) for name, script in scripts.items()]


def _scripts(system: System, rng: np.random.Generator) -> dict[str, Iterator[Segment]]:
    """Return an endless script for each manoeuvre; each has its own stream of random numbers."""
    ends = _ends(system)
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
        scripts[f"random-{mean:g}"] = _switch(system, mean, own())
    return scripts


def _levels(channel: Channel) -> Array:
    """Return the values of a control to excite with, in rising order."""
    if channel.levels is not None:
        return np.array(channel.levels)
    if not channel.bounded:
        raise InvalidArgument(
            f"excitation: control {channel.name!r} has no finite limits: give it low and high, or levels"
        )
    return np.unique([channel.low, channel.neutral, channel.high])


def _ends(system: System) -> list[float]:
    """Return full speed forward and, if the system can, backward."""
    high, low = _levels(system.controls[0])[[-1, 0]].tolist()
    return [high] if low == system.controls[0].neutral else [high, low]


def _command(system: System, propel: float, steer: float | None = None) -> Array:
    control = system.neutral_control.copy()
    if steer is not None and system.nu > 1:
        control[-1] = steer
    control[0] = propel
    return control


def _shuffled(values: Array, rng: np.random.Generator) -> Iterator[float]:
    """Yield all values in random order, for ever."""
    while True:
        yield from rng.permutation(values).tolist()


def _loop(system: System, propel: float, rng: np.random.Generator) -> Iterator[Segment]:
    """Full speed, a few circles to one side, a straight, a few circles to the other."""
    limits = _levels(system.controls[-1])[[-1, 0]].tolist()
    while True:
        for steer in limits:
            yield _command(system, propel, steer), rng.uniform(3.0, 6.0)
            yield _command(system, propel), rng.uniform(1.0, 3.0)


def _figure_8(system: System, propel: float, rng: np.random.Generator) -> Iterator[Segment]:
    """Full speed, steering from one limit to the other about once a circle."""
    limits = _levels(system.controls[-1])[[-1, 0]].tolist()
    while True:
        for steer in limits:
            yield _command(system, propel, steer), rng.uniform(1.8, 2.8)


def _weave(system: System, rng: np.random.Generator) -> Iterator[Segment]:
    """Full speed and short taps of the steering, forward and backward in turn."""
    steers = _shuffled(_levels(system.controls[-1]), rng)
    while True:
        for propel in _ends(system):
            for _ in range(10):
                yield _command(system, propel, next(steers)), rng.uniform(0.15, 0.7)


def _start_and_stop(system: System, rng: np.random.Generator) -> Iterator[Segment]:
    """Launches in either direction, then coasting until the car stands, under every steering."""
    steers = _shuffled(_levels(system.controls[-1]), rng)
    while True:
        for propel in _ends(system):
            steer = next(steers)
            yield _command(system, propel, steer), rng.uniform(0.3, 2.0)
            yield _command(system, float(system.neutral_control[0]), steer), rng.uniform(0.5, 2.5)


def _reverse(system: System, rng: np.random.Generator) -> Iterator[Segment]:
    """From full speed one way to full speed the other, under every steering."""
    steers = _shuffled(_levels(system.controls[-1]), rng)
    while True:
        for propel in _ends(system):
            yield _command(system, propel, next(steers)), rng.uniform(0.5, 2.0)


def _switch(system: System, mean: float, rng: np.random.Generator) -> Iterator[Segment]:
    """Every control jumps to a random level at random times, each for itself."""
    levels = [_levels(channel) for channel in system.controls]
    control = np.array([rng.choice(values) for values in levels])
    jumps = rng.exponential(mean, system.nu)
    now = 0.0
    while True:
        channel = int(np.argmin(jumps))
        yield control.copy(), float(jumps[channel]) - now
        now = float(jumps[channel])
        control[channel] = rng.choice(levels[channel])
        jumps[channel] += rng.exponential(mean)


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
