"""Regions of states and controls where a model's error is larger than elsewhere."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from evaluation.prediction.cases import MeasuredCases
from sysid_evo.data.units import spelled
from sysid_evo.system import Channel, System
from sysid_evo.types import Array, BoolArray
from sysid_evo.validation.estimates import Draws, Estimate, drawn_sums

LOW, HIGH = 20.0, 80.0
"""Percentiles that bound the regions of a continuous channel."""
LEVELS = 5
"""A channel with at most this number of values is divided by value."""
NOTABLE = 1.3
"""Ratio to the N of all windows from which a region is mentioned, if the interval is above 1, too."""
FEWEST_BLOCKS = 4
"""Minimum number of blocks in which a region must occur to have an interval."""


@dataclass(frozen=True)
class Region:
    """A part of the range of one channel: at or beyond a ``limit``, within a distance of neutral, or at a value.

    ``kind`` is ``below``, ``above``, ``beyond`` (farther than ``limit`` from ``neutral`` on either side) or ``at``.
    ``end``: the limit, as it is written, is the end of the range, and no value is beyond it.
    """

    channel: str
    unit: str
    kind: str
    limit: float
    neutral: float = 0.0
    end: bool = False

    @property
    def words(self) -> str:
        """The region in words, such as ``forward_speed above 1.2 m/s``."""
        value = f"{_written(self.limit)}{f' {self.unit}' if self.unit else ''}"
        if self.kind == "beyond":
            off = f"{self.channel} - {_written(self.neutral)}" if self.neutral else self.channel
            return f"|{off}| {'at' if self.end else 'above'} {value}"
        return f"{self.channel} {'at' if self.end else self.kind} {value}"

    def within(self, low: float | None, high: float | None) -> Region:
        """Return the region of a channel whose values are from ``low`` to ``high``; None for an open end."""
        if self.kind == "beyond":
            last = None if low is None or high is None else max(high - self.neutral, self.neutral - low)
        else:
            last = {"below": low, "above": high}.get(self.kind)
        return replace(self, end=last is not None and _written(self.limit) == _written(last))

    def holds(self, values: Array) -> BoolArray:
        """Return which of the channel's ``values`` (N,) are inside."""
        if self.kind == "below":
            return np.asarray(values <= self.limit)
        if self.kind == "above":
            return np.asarray(values >= self.limit)
        if self.kind == "beyond":
            return np.asarray(np.abs(values - self.neutral) >= self.limit)
        return np.asarray(values == self.limit)


@dataclass(frozen=True)
class RegionError:
    """N of the windows that start in ``region``, a ``share`` of all, and its ``ratio`` to the N of all windows.

    The intervals of the ratios are simultaneous ones: together they cover the true values of all tested regions.
    """

    region: Region
    share: float
    n: float
    ratio: Estimate

    @property
    def words(self) -> str:
        """Region and size of its error, in words."""
        return f"with {self.region.words}, N is {self.ratio.value:.1f} times that of all windows"


def region_errors(cases: MeasuredCases, predicted: Array, horizon: int) -> tuple[RegionError, ...]:
    """Return N of each region, the largest first; ``predicted`` (N, H, nx) are the simulated windows.

    A window belongs to the regions of its start state and its first control.
    """
    scored = cases.moving[:, horizon - 1]
    errors = cases.system.difference(predicted[:, horizon - 1], cases.windows.states[:, horizon - 1])
    squares = np.where(scored[:, None], errors**2, 0.0)
    counts = scored.astype(np.float64)[:, None]
    blocks = cases.window_block
    columns, places = [np.concatenate([squares, counts], axis=1)], []
    start, control = cases.windows.start_states, cases.windows.controls[:, 0]
    for region, inside in candidate_regions(cases.system, start, control):
        chosen = inside & scored
        if len(np.unique(blocks[chosen])) >= FEWEST_BLOCKS:
            places.append((region, float(chosen.sum() / scored.sum())))
            columns.append(columns[0] * chosen[:, None])
    if not places:
        return ()
    drawn = cases.n_of_sums(drawn_sums(np.concatenate(columns, axis=1), blocks))
    whole, *each = (Draws(column, len(np.unique(blocks))) for column in drawn.T)
    found = [
        RegionError(region, share, one.value, one.times(whole, figures=len(places)))
        for (region, share), one in zip(places, each, strict=True)
        if whole.value > 0.0 and np.isfinite(one.value)
    ]
    return tuple(sorted(found, key=lambda one: -one.ratio.value))


def worst_region(regions: tuple[RegionError, ...]) -> RegionError | None:
    """Return the region with the largest N among those clearly above all windows; None if there is none."""
    return next((one for one in regions if one.ratio.low > 1.0 and one.ratio.value >= NOTABLE), None)


def candidate_regions(system: System, states: Array, controls: Array) -> Iterator[tuple[Region, BoolArray]]:
    """Yield regions of each channel and which of the rows (N,) are inside."""
    wrapped = system.wrap(states)
    for channel, values in (
        *zip(system.states, wrapped.T, strict=True),
        *zip(system.controls, controls.T, strict=True),
    ):
        for region in _regions(channel, values):
            yield region, region.holds(values)


def _regions(channel: Channel, values: Array) -> Iterator[Region]:
    different = np.unique(values)
    if len(different) < 2:
        return
    if len(different) <= LEVELS:
        for value in different:
            yield Region(channel.name, channel.unit, "at", float(value))
        return
    low, high = np.percentile(values, [LOW, HIGH])
    ends = float(different[0]), float(different[-1])
    yield Region(channel.name, channel.unit, "below", float(low)).within(*ends)
    yield Region(channel.name, channel.unit, "above", float(high)).within(*ends)
    if low < channel.neutral < high:
        size = float(np.percentile(np.abs(values - channel.neutral), HIGH))
        yield Region(channel.name, channel.unit, "beyond", size, channel.neutral).within(*ends)


def _written(value: float) -> str:
    return spelled(value, digits=2)
