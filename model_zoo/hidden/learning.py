"""From recordings to one trained space: the linear start, short free runs, then long ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from model_zoo.hidden.observer import Observer, observer
from model_zoo.hidden.records import Record, Scales, Segments, records
from model_zoo.hidden.shooting import Spaces, Trained, train
from model_zoo.hidden.subspace import Subspace, linear_space
from sysid_evo.arrays import Array
from sysid_evo.data import Dataset

SHORT = 100
"""Steps of the first free runs: a long one of a poor model says little."""
LOST = 1.0
"""A root mean square residual, in deviations, from which a training begins anew at the linear start."""


@dataclass(frozen=True)
class Lesson:
    """Recordings in units of deviation, and segments of at most ``horizon`` steps of them."""

    scales: Scales
    parts: list[Record]
    horizon: int

    @classmethod
    def of(cls, dataset: Dataset, horizon: int, scales: Scales | None = None) -> Self:
        """Prepare ``dataset`` in its own units of deviation, or in those given."""
        scales = scales or Scales.of(dataset)
        return cls(scales, records(dataset, scales), horizon)

    @cached_property
    def subspace(self) -> Subspace:
        """What the past tells of the outputs."""
        return Subspace.of(self.parts)

    @cached_property
    def short(self) -> Segments:
        return Segments.of(self.parts, min(SHORT, self.horizon))

    @cached_property
    def long(self) -> Segments:
        return Segments.of(self.parts, self.horizon)

    @property
    def at_last(self) -> Segments:
        """The segments that training ends with."""
        return self.short if self.horizon <= SHORT else self.long

    def linear(self, order: int) -> Spaces:
        """Return the linear space that the subspace gives, as it is."""
        found = linear_space(self.subspace, order)
        outer = found.rates / found.pace[:, None]
        return Spaces(outer[None], np.empty((1, 0, outer.shape[1])), found.pace, ("smooth",))

    def blank(self, segments: Segments, spaces: Spaces) -> Array:
        """Return initial states (S, B, n) of which the outputs alone are known."""
        starts = np.zeros((len(spaces), len(segments), spaces.n))
        ny = segments.outputs.shape[2]
        starts[:, :, :ny] = segments.outputs[:, 0]
        return starts

    def states(self, trained: Trained, segments: Segments) -> Array:
        """Return the states (S, N, n) of the runs at all samples that count, in a row."""
        runs = trained.spaces.run(trained.starts, segments.controls)
        return np.stack([segments.rows(run) for run in runs])

    def learned(
        self, spaces: Spaces, iterations: int, told: Callable[[], None], *, starts: Array | None = None
    ) -> Trained:
        """Train on short free runs, from ``starts`` if they are known."""
        return train(spaces, self.short, self.blank(self.short, spaces) if starts is None else starts, iterations, told)

    def lengthened(self, trained: Trained, fallback: Spaces, iterations: int, told: Callable[[], None]) -> Trained:
        """Go on with long free runs; spaces that lose their way there begin at ``fallback`` (one space) again."""
        if self.horizon <= SHORT:
            for _ in range(iterations):
                told()
            return trained
        starts = self.states(trained, self.short)[:, self.long.begins]
        spaces = trained.spaces
        runs = spaces.run(starts, self.long.controls)[..., : self.long.outputs.shape[2]]
        off = ((runs - self.long.outputs) ** 2 * self.long.counts[:, :, None]).sum(axis=(1, 2, 3))
        lost = off > LOST**2 * self.long.counts.sum() * runs.shape[3]
        if lost.any():
            outer = spaces.outer.copy()
            outer[lost] = 0.0
            outer[lost, :, : fallback.outer.shape[2]] = fallback.outer[0]
            spaces = Spaces(outer, spaces.inner, spaces.pace, spaces.units)
            starts[lost] = self.blank(self.long, spaces)[lost]
        return train(spaces, self.long, starts, iterations, told)

    def observers(self, trained: Trained) -> list[Observer]:
        """Return an observer of every space of a training on long free runs."""
        runs, outputs = self.states(trained, self.at_last), self.at_last.rows(self.at_last.outputs)
        return [observer(trained.spaces[[s]], runs[s], outputs, self.parts) for s in range(len(runs))]
