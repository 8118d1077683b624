"""Scripted manoeuvres that span the driving envelope without racing (paper, section 3)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain

import numpy as np

from hardware.recording.signals import Segment, extremes, signals, switches
from sysid_evo.arrays import Array, check_shape
from sysid_evo.errors import InvalidArgument
from sysid_evo.system import System

DURATION = 360.0  # s: "about 6 minutes of driving data"
ROUND = 300
"""Samples that a manoeuvre of a system that goes nowhere lasts; there are as many rounds as fit."""
SHORTEST = 1.0  # s that a manoeuvre must last to be worth a recording
LEAD = 0.5  # s without a command at the start, so that preparation, which cuts the ends, leaves the launch in
HOLDS = (0.1, 0.2, 0.4, 0.8, 1.6)  # s: mean time between random switches, from faster than the car to slower


@dataclass(frozen=True)
class Manoeuvre:
    """A named sequence of controls (T, nu), one for each ``dt`` of the system."""

    name: str
    controls: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "controls", check_shape(f"controls of {self.name!r}", self.controls, (None, None)))


def excitation(system: System, *, duration: float = DURATION, rng: np.random.Generator) -> list[Manoeuvre]:
    """Return manoeuvres of equal length, ``duration`` s in all, each with half a second of rest first.

    A system without a motion gets `signals`, in as many rounds as last some `ROUND` samples each. One with
    a motion gets twelve manoeuvres that drive: the first control is taken for the one that propels, the last for
    the one that steers; controls between them move in the random manoeuvres only. A continuous control uses
    its two limits and its neutral value. Manoeuvres for which a system has no control (steering, driving backward)
    are left out. Raises `InvalidArgument`.
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
    """Return the signals as often as there is time for, numbered from the second round on."""
    scripts = signals(system, rng)
    rounds = round(duration / (len(scripts) * ROUND * system.dt))
    for number in range(2, rounds + 1):
        scripts |= {f"{name}-{number}": script for name, script in signals(system, rng).items()}
    return scripts


def _driving(system: System, rng: np.random.Generator) -> dict[str, Iterator[Segment]]:
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
        scripts[f"random-{mean:g}"] = switches(system, mean, own())
    return scripts


def _ends(system: System) -> list[float]:
    """Return full speed forward and, if the system can, backward."""
    high, low = extremes(system.controls[0])[[-1, 0]].tolist()
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
    """Full speed and short taps of the steering, forward and backward in turn."""
    steers = _shuffled(extremes(system.controls[-1]), rng)
    while True:
        for propel in _ends(system):
            for _ in range(10):
                yield _command(system, propel, next(steers)), rng.uniform(0.15, 0.7)


def _start_and_stop(system: System, rng: np.random.Generator) -> Iterator[Segment]:
    """Launches in either direction, then coasting until the car stands, under every steering."""
    steers = _shuffled(extremes(system.controls[-1]), rng)
    while True:
        for propel in _ends(system):
            steer = next(steers)
            yield _command(system, propel, steer), rng.uniform(0.3, 2.0)
            yield _command(system, float(system.neutral_control[0]), steer), rng.uniform(0.5, 2.5)


def _reverse(system: System, rng: np.random.Generator) -> Iterator[Segment]:
    """From full speed one way to full speed the other, under every steering."""
    steers = _shuffled(extremes(system.controls[-1]), rng)
    while True:
        for propel in _ends(system):
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
