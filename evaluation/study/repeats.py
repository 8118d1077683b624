"""Means over robots and seeds, with bootstrap intervals that say what to expect of other robots and seeds.

Robots are drawn with replacement, then seeds of each. The percentiles of so few draws are too narrow: of five robots
with five seeds those for 95 % hold the truth in about 85 %. They are expanded as Hesterberg (2015, The American
Statistician 69, section 4.3) proposes: as many times as Student's quantile is beyond the normal one, and the spread of
a sample below that of what it comes from. Then it is 94 % and more; ``docs/study.md`` has a table.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from scipy.special import ndtr, stdtrit

from sysid_evo.arrays import Array

RESAMPLES = 4000
SHARE = 0.95
FEWEST = 3
"""Robots, or seeds of a single one, below which there is no interval."""

Repeats: TypeAlias = Mapping[tuple[str, str], float]
"""A number by robot and seed."""


@dataclass(frozen=True)
class Spread:
    """The mean over ``robots``, of the mean over the seeds of each, and its 95 % interval, None where there is none.

    ``lowest`` and ``highest`` are those of single points, ``points`` how many there are.
    """

    mean: float
    low: float | None
    high: float | None
    lowest: float
    highest: float
    robots: int
    points: int

    @classmethod
    def of(cls, repeats: Repeats, *, seed: int = 0) -> Spread | None:
        """Return the spread of numbers by robot and seed, None for none; what is no number is left out."""
        known = {key: value for key, value in repeats.items() if np.isfinite(value)}
        if not known:
            return None
        by_robot: dict[str, list[float]] = {}
        for (robot, _), value in known.items():
            by_robot.setdefault(robot, []).append(value)
        groups = [np.array(values) for values in by_robot.values()]
        low, high = _interval(groups, seed)
        values = np.array(list(known.values()))
        mean = float(np.mean([group.mean() for group in groups]))
        return cls(mean, low, high, float(values.min()), float(values.max()), len(groups), len(values))


def paired(first: Repeats, second: Repeats) -> Repeats:
    """Return the first minus the second for each robot and seed that both have."""
    return {key: first[key] - second[key] for key in first if key in second}


def _interval(groups: list[Array], seed: int) -> tuple[float | None, float | None]:
    """Return the expanded percentiles of the means of drawn robots and seeds."""
    count = len(groups) if len(groups) > 1 else len(groups[0])
    if count < FEWEST:
        return None, None
    rng = np.random.default_rng(seed)
    means = np.stack(
        [group[rng.integers(0, len(group), (RESAMPLES, len(groups), len(group)))].mean(2) for group in groups]
    )
    robots = rng.integers(0, len(groups), (RESAMPLES, len(groups)))
    drawn = means[robots, np.arange(RESAMPLES)[:, None], np.arange(len(groups))].mean(axis=1)
    tail = float(ndtr(stdtrit(count - 1, 0.5 - 0.5 * SHARE) * np.sqrt(count / (count - 1))))
    low, high = np.quantile(drawn, [tail, 1.0 - tail])
    return float(low), float(high)
