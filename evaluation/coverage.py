"""States and controls that controllers use and recordings do not cover: shares, gaps, boxes to record next."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from evaluation.prediction.regions import LEVELS, Region
from evaluation.steps import Steps
from sysid_evo.data import Trajectory
from sysid_evo.data.support import Support
from sysid_evo.data.units import spelled_range
from sysid_evo.system import Channel, System
from sysid_evo.types import Array, BoolArray

MAX_REGIONS = 5
"""Maximum number of regions that are returned."""
LEAST_SHARE = 0.002
"""A region that is visited less than this is left out."""
PERIODIC_BINS, CONTROL_BINS = 12, 3
ROUND = np.array([1.0, 2.0, 5.0, 10.0])


@dataclass(frozen=True)
class UncoveredBox:
    """A box: the lowest and highest value of each state and control in their units, ``low`` and ``high`` (nx + nu,).

    It contains the share ``share`` of all driven steps, outside the data. A switch has one value.
    """

    channels: tuple[Channel, ...]
    low: Array
    high: Array
    share: float

    @property
    def words(self) -> str:
        """The region in words."""
        parts = []
        for channel, low, high in zip(self.channels, self.low, self.high, strict=True):
            unit = f" {channel.unit}" if channel.unit else ""
            parts.append(f"{channel.name} {spelled_range(low, high)}{unit}")
        return ", ".join(parts)


def suggest_recordings(
    support: Support, driven: Steps | Iterable[Trajectory], *, most: int = MAX_REGIONS
) -> tuple[UncoveredBox, ...]:
    """Return the boxes of states and controls in which ``driven`` is most often outside the data.

    States are divided into boxes about one standard deviation of the data wide, at round numbers; a switch has a box
    for each position, a continuous control three. The most visited box comes first; rare ones are left out.
    """
    system = support.system
    steps = driven if isinstance(driven, Steps) else Steps.of(system, driven)
    if not len(steps):
        return ()
    outside = support.distances(steps.before, steps.control) > support.limit
    values = np.concatenate([steps.before, steps.control], axis=1)[outside]
    for i, period in system.periods.items():
        values[:, i] -= period * np.round(values[:, i] / period)
    channels = (*system.states, *system.controls)
    width = _widths(support)
    # the first box of a channel begins at its lowest value, or a multiple of the width; an open range has no last box
    begin = np.array([c.low if np.isfinite(c.low) and not c.period else 0.0 for c in channels])
    end = np.array([np.inf if c.period else c.high for c in channels])
    with np.errstate(divide="ignore", invalid="ignore"):
        boxes = np.where(width > 0.0, np.floor((values - begin) / width + 1e-9), values)
        last = np.where(width > 0.0, np.round((end - begin) / width) - 1.0, np.inf)
    boxes = np.minimum(boxes, last)  # the end of a range belongs to its last box
    found = []
    for box, count in Counter(map(tuple, boxes.tolist())).most_common(most):
        if count / len(steps) < LEAST_SHARE:
            break
        low = np.where(width > 0.0, begin + np.array(box) * width, box)
        found.append(UncoveredBox(channels, low.round(12) + 0.0, (low + width).round(12) + 0.0, count / len(steps)))
    return tuple(found)


def _widths(support: Support) -> Array:
    """Return the width of the boxes in each channel (nx + nu,), 0 for a switch."""
    system = support.system
    spread = dict(zip((*system.regressor_names, *system.control_names), support.scale, strict=True))
    widths = [c.period / PERIODIC_BINS if c.period else _rounded(spread[c.name]) for c in system.states]
    for c in system.controls:
        span = 0.0 if c.levels is not None else c.high - c.low
        widths.append(span / CONTROL_BINS if np.isfinite(span) else _rounded(spread[c.name]))
    return np.array(widths)


def _rounded(width: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that is not above ``width``."""
    power = 10.0 ** np.floor(np.log10(width))
    return float(power * ROUND[width / power * (1.0 + 1e-9) >= ROUND].max())


MIN_SHARE = 0.05
"""Share of the steps in one region from which it matters: a twentieth."""
RARE_RATIO = 0.1
"""A region is missing if its share of the data is below this part of that share: a tenth of uniform data."""

EDGES = (1.0, 20.0, 50.0, 80.0, 99.0)
"""Percentiles of the data at which a continuous channel is cut."""

FEWEST_STEPS, MOST_STEPS = 200, 20_000


@dataclass(frozen=True)
class CoverageGap:
    """A region of one or two channels, with the share ``needed`` of steps in it and the share ``seen`` of the data."""

    place: tuple[Region, ...]
    needed: float
    seen: float

    @property
    def words(self) -> str:
        return " and ".join(region.words for region in self.place)

    @property
    def figures(self) -> dict[str, float]:
        return {"needed": self.needed, "seen": self.seen}


def largest_gap(seen: Steps, needed: Steps) -> CoverageGap | None:
    """Return the region with the largest share of ``needed`` that ``seen`` rarely contains; None without one."""
    seen, needed = seen.thinned(MOST_STEPS), needed.thinned(MOST_STEPS)
    if len(seen) < FEWEST_STEPS or len(needed) < FEWEST_STEPS:
        return None
    regions = _regions(seen.system, _columns(seen))
    wanted, channels = _together(regions, needed), np.array([region.channel for region in regions])
    other = (channels[:, None] != channels[None, :]) | np.eye(len(regions), dtype=bool)
    return _largest(regions, other & (wanted >= MIN_SHARE), wanted, _together(regions, seen))


UNTRIED = 0.03
"""Share from which an untried pair matters: that of the state in the time, times that of the command."""


def untried_pair(seen: Steps) -> CoverageGap | None:
    """Return a state and a command that both occur in ``seen``, but rarely together; None without one.

    Its share ``needed`` is the share it would have if every command were given in every state.
    """
    if len(seen) < FEWEST_STEPS or not seen.system.nu:
        return None
    regions = _regions(seen.system, _columns(seen))
    together = _together(regions, seen)
    expected = np.outer(np.diag(together), np.diag(together))
    states = np.array([region.channel in seen.system.state_names for region in regions])
    return _largest(regions, states[:, None] & ~states[None, :] & (expected >= UNTRIED), expected, together)


def _largest(regions: Sequence[Region], candidates: BoolArray, wanted: Array, there: Array) -> CoverageGap | None:
    """Return the pair of regions with the largest share ``wanted`` among ``candidates`` that are rarely ``there``.

    All three are (regions, regions). A single region is simpler, and returned if its share is nearly as large.
    """
    size = np.where(candidates & (there <= RARE_RATIO * wanted), wanted, 0.0)
    if not size.any():
        return None
    single = np.diag(size)
    first = second = int(single.argmax())
    if single.max() < 0.8 * size.max():
        first, second = (int(place) for place in np.unravel_index(int(size.argmax()), size.shape))
    place = (regions[first],) if first == second else (regions[first], regions[second])
    return CoverageGap(place, float(wanted[first, second]), float(there[first, second]))


def _columns(steps: Steps) -> Array:
    return np.concatenate([steps.system.wrap(steps.before), steps.control], axis=1)


def _together(regions: Sequence[Region], steps: Steps) -> Array:
    """Return the share of steps that lie in two regions at once, (regions, regions); in each on the diagonal."""
    channels = (*steps.system.state_names, *steps.system.control_names)
    columns = dict(zip(channels, _columns(steps).T, strict=True))
    inside = np.stack([region.holds(columns[region.channel]) for region in regions], axis=1).astype(np.float64)
    return np.asarray(inside.T @ inside / len(inside))


def _regions(system: System, columns: Array) -> list[Region]:
    found = []
    for channel, values in zip((*system.states, *system.controls), columns.T, strict=True):
        unit, low, high = channel.unit, channel.low, channel.high
        if channel.levels is not None or len(np.unique(values)) <= LEVELS:
            levels = np.unique(values) if channel.levels is None else channel.levels
            found += [Region(channel.name, unit, "at", float(level)) for level in levels]
            continue
        cuts = [(float(np.percentile(values, edge)), edge) for edge in EDGES]
        below = [Region(channel.name, unit, "below", limit) for limit, edge in cuts if edge <= 50.0]
        above = [Region(channel.name, unit, "above", limit) for limit, edge in cuts if edge >= 50.0]
        found += [region.within(low, high) for region in below + above]
    return found
