"""Who beats whom: the order of the families after one second, by paired bootstrap."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TypeAlias

import numpy as np

from evaluation.prediction.bootstrap import interval
from sysid_evo.arrays import Array

Scores: TypeAlias = Mapping[str, tuple[float, Array]]
"""For every family its N and the resamples (R,), which are those of the same windows for all."""

EXCUSED = frozenset({"backprop27", "evolved3", "nearest_neighbour", "parametrised", "linear"})
"""The paper's four and the plainest family, which stay whatever they reach."""


def beaten(scores: Scores, name: str) -> list[str]:
    """Return the families whose N is surely above that of ``name``: the 95 % interval of the difference is."""
    own = scores[name][1]
    return [other for other, (_, draws) in scores.items() if other != name and interval(own - draws, 0.95).high < 0.0]


def standing(by_log: Mapping[str, Scores], write: Callable[[str], object]) -> None:
    """Write whom each family beats on every log, and which beats none of the zoo on any."""
    write("\nwho beats whom after one second (the 95 % interval of the difference is below zero):\n")
    names = list(next(iter(by_log.values())))
    for name in sorted(names, key=lambda n: float(np.mean([scores[n][0] for scores in by_log.values()]))):
        write(f"  {name}\n")
        for log, scores in by_log.items():
            write(f"    {log}: {', '.join(beaten(scores, name)) or 'none'}\n")
    idle = [name for name in names if not any(beaten(scores, name) for scores in by_log.values())]
    idle = [name for name in idle if name not in EXCUSED]
    write(f"  families that beat none on any log: {', '.join(idle) or 'none'}\n")
