"""What excites an environment: steps, sine sweeps, and feedback drawn at random."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass

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
FEW, AGAIN, NEAR = 20, 0.5, 0.1
"""Feedbacks tried before one comes again, the share of episodes in which one does, and how far its weights move."""


class Script(ABC):
    """Gives one control after the other, for ever: numbers in [-1, 1] for `System.actuate`."""

    @abstractmethod
    def begin(self, lasted: int) -> None:
        """Start anew: an episode begins; the one before ``lasted`` so many steps, 0 if there was none."""

    @abstractmethod
    def next(self, state: Array) -> Array:
        """Return the next control (nu,), in ``state`` (nx,)."""


class Steps(Script):
    """Every control jumps to a value at random times, each for itself; one time in three to one of its limits."""

    def __init__(self, system: System, mean: float, rng: np.random.Generator) -> None:
        self._rng, self._mean = rng, mean
        self._value = self._drawn(system.nu)

    def begin(self, lasted: int) -> None:
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

    def begin(self, lasted: int) -> None:
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


@dataclass(frozen=True)
class Tried:
    """The ``weights`` (nu, n) of a feedback, and how many steps its episode ``lasted``."""

    lasted: int
    weights: Array


class RandomFeedback(Script):
    """A feedback towards a state seen before, with weights drawn for every episode and some steps in between.

    An environment whose episodes end soon under any fixed sequence, as those of a cart with a pole do, lasts under
    some feedbacks, and swings far under others. Every second episode takes weights near those of one that lasted
    long, so that it goes where the state can be kept. ``seen`` are states (N, nx) that give scale and aims,
    ``tried`` what was tried before, to which this one adds.
    """

    def __init__(self, system: System, seen: Array, tried: list[Tried], rng: np.random.Generator) -> None:
        self._system, self._rng, self._tried = system, rng, tried
        self._seen = system.regressors(seen)
        spread = self._seen.std(axis=0)
        self._scale = 1.0 / np.where(spread > 0.0, spread, 1.0)
        self._steps = Steps(system, 3.0, rng)
        self._weights = np.zeros((system.nu, len(self._scale)))
        self.begin(0)

    def begin(self, lasted: int) -> None:
        if lasted > 0:
            self._tried.append(Tried(lasted, self._weights * self._scale))
        self._weights = self._drawn()
        self._aim = self._seen[self._rng.integers(len(self._seen))]
        self._dither = self._rng.uniform(0.0, 2.0 * FEEDBACK)

    def next(self, state: Array) -> Array:
        step = self._steps.next(state)
        if self._rng.random() < self._dither:
            return step
        return np.tanh(self._weights @ ((self._system.regressors(state) - self._aim) * self._scale))

    def _drawn(self) -> Array:
        """Return new weights, or some near those that lasted longest."""
        drawn = self._rng.standard_normal(self._weights.shape)
        if len(self._tried) >= FEW and self._rng.random() < AGAIN:
            longest = sorted(self._tried, key=lambda one: -one.lasted)[: max(1, len(self._tried) // 20)]
            weights: Array = longest[self._rng.integers(len(longest))].weights / self._scale
            return weights + NEAR * np.abs(weights) * drawn
        return float(np.exp(self._rng.uniform(-1.5, 1.5))) * drawn
