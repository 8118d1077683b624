"""Signals that excite any system: steps, switches and sine sweeps, from fast to slow."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import TypeAlias

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.errors import InvalidArgument
from sysid_evo.system import Channel, System

STEP_HOLDS = (3, 10, 30, 100)
"""Mean time between random steps, in samples."""
SWITCH_HOLDS = (5, 15, 45)
"""Mean time between random switches from one limit to the other, in samples."""
FASTEST, SLOWEST = 6, 150
"""Periods between which a sine sweeps, in samples."""
SWEEP = 280
"""Samples that the sweeps of all controls take, one after the other; then they begin anew."""

Segment: TypeAlias = tuple[Array, float]
"""A control (nu,) and how long to hold it, in s."""


def signals(system: System, rng: np.random.Generator) -> dict[str, Iterator[Segment]]:
    """Return an endless script for each signal, for systems that go nowhere; each has its own random numbers."""
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
    """Every control jumps to a random extreme at random times, ``mean`` s apart, each for itself."""
    levels = [extremes(channel) for channel in system.controls]

    def draw(control: int) -> float:
        return float(rng.choice(levels[control]))

    return _jumps(system.nu, draw, mean, rng)


def steps(system: System, mean: float, rng: np.random.Generator) -> Iterator[Segment]:
    """Every control jumps to a random value within its limits at random times, ``mean`` s apart, each for itself."""
    levels = [extremes(channel) for channel in system.controls]

    def draw(control: int) -> float:
        return _legal(system.controls[control], rng.uniform(levels[control][0], levels[control][-1]))

    return _jumps(system.nu, draw, mean, rng)


def sweep(system: System, first: float, last: float) -> Iterator[Segment]:
    """Each control in turn follows a sine over its limits, its period going from ``first`` to ``last`` samples."""
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
