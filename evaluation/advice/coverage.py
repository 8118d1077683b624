"""Where controllers go, or tests lie, and the data do not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from evaluation.advice.evidence import Evidence
from evaluation.advice.remark import Remark
from evaluation.exploitability.steps import Steps
from evaluation.labels import percent
from evaluation.prediction import Region
from evaluation.prediction.regions import LEVELS
from sysid_evo.arrays import Array, BoolArray
from sysid_evo.system import Channel, System

ASKED = 0.05
"""Share of the time at one place from which on it matters: a twentieth."""
RARELY = 0.1
"""A place is missing if the data spend less than this part of that share there: a tenth of what uniform data would."""
UNTRIED = 0.03
"""And of the time of a state times that of a command, where no controllers are known."""
EDGES = (1.0, 20.0, 50.0, 80.0, 99.0)
"""Percentiles of the data at which a continuous channel is cut."""
FEWEST, MOST_STEPS = 200, 20_000


@dataclass(frozen=True)
class Gap:
    """A place, of one or two channels, where the share ``asked`` of steps lies and the share ``seen`` of the data."""

    place: tuple[Region, ...]
    asked: float
    seen: float

    @property
    def words(self) -> str:
        return " and ".join(region.words for region in self.place)

    @property
    def figures(self) -> dict[str, float]:
        return {"asked": self.asked, "seen": self.seen}


def missing_excitation(evidence: Evidence) -> Remark | None:
    """Return where controllers go and the training data do not; without controllers, which commands were not tried."""
    seen = Steps.moving(evidence.training).thinned(MOST_STEPS)
    if evidence.visited is None or len(evidence.visited) < FEWEST:
        return _untried(evidence, seen)
    gap = largest_gap(seen, evidence.visited)
    if gap is None:
        return None
    return Remark(
        "excitation",
        f"Controllers spend {percent(gap.asked)} of their time with {gap.words}, the training data {_share(gap.seen)}: "
        "models guess there. Record just that.",
        gap.asked,
        gap.figures,
    )


def other_states(evidence: Evidence) -> Remark | None:
    """Return where the test part lies and the training part does not, or where controllers go and no test is made."""
    if evidence.test is None:
        return None
    held_out = Steps.moving(evidence.test)
    gap = largest_gap(Steps.moving(evidence.training), held_out)
    if gap is not None:
        return Remark(
            "test part",
            f"{percent(gap.asked)} of the test part has {gap.words}, of the training part {_share(gap.seen)}: its "
            "errors tell how models extrapolate. Hold out other recordings (--test), or record more there.",
            gap.asked,
            gap.figures,
        )
    if evidence.visited is None or len(evidence.visited) < FEWEST:
        return None
    gap = largest_gap(held_out, evidence.visited)
    if gap is None or missing_excitation(evidence) is not None:
        return None
    return Remark(
        "test part",
        f"Controllers spend {percent(gap.asked)} of their time with {gap.words}, the test part {_share(gap.seen)}: its "
        "errors say nothing of what models do there. Hold out driving that comes there.",
        0.5 * gap.asked,
        gap.figures,
    )


def _untried(evidence: Evidence, seen: Steps) -> Remark | None:
    """Return the state and command that each occur, and hardly together."""
    if len(seen) < FEWEST or not evidence.system.nu:
        return None
    regions = _regions(seen.system, _columns(seen))
    inside = _inside(regions, seen.system, seen)
    alone, together = inside.mean(axis=0), inside.T @ inside / len(inside)
    expected = np.outer(alone, alone)
    states = np.array([region.channel in evidence.system.state_names for region in regions])
    pairs = states[:, None] & ~states[None, :] & (expected >= UNTRIED) & (together <= RARELY * expected)
    if not pairs.any():
        return None
    size = np.where(pairs, expected, 0.0)
    state, command = np.unravel_index(int(size.argmax()), size.shape)
    gap = Gap((regions[command], regions[state]), float(expected[state, command]), float(together[state, command]))
    return Remark(
        "excitation",
        f"{gap.place[0].words} was hardly tried with {gap.place[1].words}: {_share(gap.seen)} of the time, and it "
        f"would be {percent(gap.asked)} if every command were tried everywhere. A controller that does so leaves the "
        "data: record it.",
        0.5 * gap.asked,
        gap.figures,
    )


def largest_gap(seen: Steps, asked: Steps) -> Gap | None:
    """Return the place with the largest share of ``asked`` among those that ``seen`` hardly holds; None without one."""
    system, seen, asked = seen.system, seen.thinned(MOST_STEPS), asked.thinned(MOST_STEPS)
    if len(seen) < FEWEST or len(asked) < FEWEST:
        return None
    regions = _regions(system, _columns(seen))
    shares = []
    for steps in (asked, seen):
        inside = _inside(regions, system, steps)
        shares.append(inside.T @ inside / len(inside))
    channels = np.array([region.channel for region in regions])
    same = (channels[:, None] == channels[None, :]) & ~np.eye(len(regions), dtype=bool)
    wanted, there = shares
    missing = (wanted >= ASKED) & (there <= RARELY * wanted) & ~same
    if not missing.any():
        return None
    size = np.where(missing, wanted, 0.0)
    single = np.diag(size)
    # a place of one channel says it more simply, if it is nearly as much
    if single.max() >= 0.8 * size.max():
        first = second = int(single.argmax())
    else:
        first, second = (int(place) for place in np.unravel_index(int(size.argmax()), size.shape))
    place = (regions[first],) if first == second else (regions[first], regions[second])
    return Gap(place, float(wanted[first, second]), float(there[first, second]))


def _columns(steps: Steps) -> Array:
    return np.concatenate([steps.system.wrapped(steps.before), steps.control], axis=1)


def _inside(regions: Sequence[Region], system: System, steps: Steps) -> Array:
    """Return which steps lie in which region, (N, regions), as 0 and 1."""
    columns = dict(zip((*system.state_names, *system.control_names), _columns(steps).T, strict=True))
    inside: list[BoolArray] = [region.holds(columns[region.channel]) for region in regions]
    return np.stack(inside, axis=1).astype(np.float64)


def _regions(system: System, columns: Array) -> list[Region]:
    found = []
    for channel, values in zip((*system.states, *system.controls), columns.T, strict=True):
        found += _cuts(channel, values)
    return found


def _cuts(channel: Channel, values: Array) -> list[Region]:
    if channel.levels is not None or len(np.unique(values)) <= LEVELS:
        levels = np.unique(values) if channel.levels is None else channel.levels
        return [Region(channel.name, channel.unit, "at", float(level)) for level in levels]
    cuts = [(float(np.percentile(values, edge)), edge) for edge in EDGES]
    below = [Region(channel.name, channel.unit, "below", limit) for limit, edge in cuts if edge <= 50.0]
    above = [Region(channel.name, channel.unit, "above", limit) for limit, edge in cuts if edge >= 50.0]
    return [region.within(channel.low, channel.high) for region in below + above]


def _share(share: float) -> str:
    """Return a small share with a decimal."""
    return "none" if share == 0.0 else percent(share)
