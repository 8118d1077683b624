"""What excites an environment: steps, sine sweeps, and feedback drawn at random."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.system import System

HOLDS = (1.0, 4.0, 12.0)
"""Mean samples from one step of a control to the next, from faster than most systems to slower."""
SWEEP = 200
"""Samples of one sine sweep."""
FASTEST, SLOWEST = 4.0, 100.0
"""Samples in one period at either end of a sweep."""
FEEDBACK = 0.2
"""Mean share of a feedback's samples in which a step stands in for it."""


class Script(ABC):
    """Gives one control after the other, for ever: numbers in [-1, 1] for `System.actuate`."""

    @abstractmethod
    def begin(self) -> None:
        """Start anew: an episode begins."""

    @abstractmethod
    def next(self, state: Array) -> Array:
        """Return the next control (nu,), in ``state`` (nx,)."""


class Steps(Script):
    """Every control jumps to a value at random times, each for itself; one time in three to one of its limits."""

    def __init__(self, system: System, mean: float, rng: np.random.Generator) -> None:
        self._rng, self._mean = rng, mean
        self._value = self._drawn(system.nu)

    def begin(self) -> None:
        self._value = self._drawn(len(self._value))

    def next(self, state: Array) -> Array:
        jumps = self._rng.random(len(self._value)) < 1.0 / self._mean
        self._value = np.where(jumps, self._drawn(len(self._value)), self._value)
        return self._value

    def _drawn(self, count: int) -> Array:
        inner = self._rng.uniform(-1.0, 1.0, count)
        return np.where(self._rng.random(count) < 1.0 / 3.0, np.sign(inner), inner)


class Sweep(Script):
    """Sines that grow faster, from one period in 100 samples to one in 4, each control at its own phase and height."""

    def __init__(self, system: System, rng: np.random.Generator) -> None:
        self._rng, self._nu = rng, system.nu
        self._values: Iterator[Array] = iter(())

    def begin(self) -> None:
        self._values = iter(())

    def next(self, state: Array) -> Array:
        value = next(self._values, None)
        if value is None:
            self._values = iter(self._sweep())
            value = next(self._values)
        return value

    def _sweep(self) -> Array:
        frequency = np.geomspace(1.0 / SLOWEST, 1.0 / FASTEST, SWEEP)[:: self._rng.choice([1, -1])]
        phase = 2.0 * np.pi * (np.cumsum(frequency)[:, None] + self._rng.random(self._nu))
        return self._rng.uniform(0.3, 1.0, self._nu) * np.sin(phase)


class RandomFeedback(Script):
    """A feedback of the state whose weights are drawn for every episode, with some steps in between.

    An environment whose episodes end soon under any fixed sequence, as those of a cart with a pole do, lasts under
    some feedbacks, and swings far under others. ``seen`` are states (N, nx) that give the scale.
    """

    def __init__(self, system: System, seen: Array, rng: np.random.Generator) -> None:
        self._system, self._rng = system, rng
        regressors = system.regressors(seen)
        self._centre, spread = regressors.mean(axis=0), regressors.std(axis=0)
        self._scale = 1.0 / np.where(spread > 0.0, spread, 1.0)
        self._steps = Steps(system, 3.0, rng)
        self.begin()

    def begin(self) -> None:
        self._weights = self._rng.standard_normal((self._system.nu, len(self._scale)))
        self._gain = np.exp(self._rng.uniform(-1.5, 1.5))
        self._dither = self._rng.uniform(0.0, 2.0 * FEEDBACK)

    def next(self, state: Array) -> Array:
        step = self._steps.next(state)
        if self._rng.random() < self._dither:
            return step
        seen = (self._system.regressors(state) - self._centre) * self._scale
        return np.tanh(self._gain * self._weights @ seen)
