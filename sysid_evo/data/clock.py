"""When the rows of a log were taken, and what was so at the samples of a uniform clock."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from sysid_evo.arrays import Array, BoolArray, IntArray

UNIFORM = 0.01
"""Stamps off by less than this share of a period need no interpolation worth mentioning."""


@dataclass(frozen=True)
class Clock:
    """Sample s of the uniform clock is at ``times[0] + s * step`` (s); ``times`` (N,) are the log's rows.

    ``note`` says how the times came about if they are not simply the stamps of a uniform log.
    """

    times: Array
    step: float
    note: str = ""

    def samples(self, rows: slice) -> IntArray:
        """Return the samples that lie within these rows."""
        place = (self.times[rows] - self.times[0]) / self.step
        return np.arange(np.ceil(place[0] - UNIFORM), np.floor(place[-1] + UNIFORM) + 1, dtype=np.int64)

    def interpolate(self, values: Array, rows: slice, samples: IntArray) -> Array:
        """Return ``values`` (N, c) at the samples, on straight lines between these rows."""
        at = self.times[0] + samples * self.step
        columns = [np.interp(at, self.times[rows], column) for column in values[rows].T]
        return np.stack(columns, axis=1) if columns else np.empty((len(samples), 0))

    def hold(self, values: Array, rows: slice, samples: IntArray) -> Array:
        """Return ``values`` (N, c) as they are held at the samples: of the last row up to half a step after each."""
        at = self.times[0] + (samples + 0.5) * self.step
        return values[rows][np.searchsorted(self.times[rows], at, side="right") - 1]


def fit_clock(stamps: Array, positions: Array, step: float) -> Clock:
    """Return the clock of a log: its stamps as they are, or a steady clock through them.

    A tracker takes its frames at a steady rate, but many loggers stamp them when they arrive. A late
    stamp then looks like a wrong position. The ``positions`` (N, any) tell which clock is right: on it
    they move more smoothly. ``stamps`` (N,) and ``step`` are in s.
    """
    since = (stamps - stamps[0]) / step
    if np.abs(since - np.round(since)).max() < UNIFORM:
        return Clock(stamps, step)
    period = float(np.median(np.diff(stamps)))
    frames = np.concatenate([[0.0], np.cumsum(np.maximum(1.0, np.round(np.diff(stamps) / period)))])
    rate, start = np.polyfit(frames, stamps, 1)
    steady = start + rate * frames
    scatter = stamps - steady
    told = f"time stamps scatter by {1e3 * scatter.std():.2g} ms around a steady {1.0 / rate:.1f} Hz"
    if np.abs(scatter).max() < 0.5 * period and _roughness(positions, steady) < _roughness(positions, stamps):
        return Clock(steady, step, f"{told} and the pose moves more smoothly on the steady clock, which is used")
    return Clock(stamps, step, f"{told}; the pose is interpolated linearly onto a uniform clock")


def pieces(breaks: BoolArray) -> list[slice]:
    """Return the runs of rows between ``breaks`` (N - 1,), which are true where row k + 1 begins a new run."""
    edges = [0, *(np.flatnonzero(breaks) + 1).tolist(), len(breaks) + 1]
    return [slice(first, last) for first, last in pairwise(edges)]


def _roughness(positions: Array, times: Array) -> float:
    velocities = np.diff(positions, axis=0) / np.diff(times)[:, None]
    return float(np.sum(np.diff(velocities, axis=0) ** 2))
