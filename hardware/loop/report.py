"""How a run of the control loop went: why it ended, how punctual it was, what it left out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from sysid_evo.arrays import Array

DRIFT_TICKS = 100
"""Ticks at either end of a run whose median lateness makes its drift."""


class Reason(Enum):
    """Why a run ended: a sentence, and the exit code of a command that ended so (0: as it should)."""

    SAMPLES = ("all samples were driven", 0)
    PILOT = ("the pilot ended the run", 0)
    LINK_LOST = ("the link to the robot or its tracker was lost", 10)
    TRACKER_LOST = ("the tracker lost the robot", 11)
    TRIPPED = ("the robot stopped itself", 12)
    NOT_FINITE = ("the control was not a number", 13)
    RESTLESS = ("the robot did not come to rest", 15)
    THREAD_DIED = ("a thread died", 14)
    SIGHUP = ("hung up", 129)
    SIGINT = ("interrupted", 130)
    SIGTERM = ("terminated", 143)

    def __init__(self, sentence: str, exit_code: int) -> None:
        self.sentence = sentence
        self.exit_code = exit_code

    @property
    def is_fault(self) -> bool:
        """Whether the run was cut short."""
        return self.exit_code != 0


@dataclass(frozen=True)
class LoopReport:
    """One run of the control loop.

    ``ticks`` commands were sent, each ``lateness`` (ticks,) s after it was due; ``gaps`` (ticks - 1,)
    are the seconds between one and the next. ``skipped`` ticks were missed and left out, ``stale``
    ones drove neutral because the newest pose was too old. ``rejected`` counts the frames that were
    not used, by reason.
    """

    reason: Reason
    detail: str
    lateness: Array
    gaps: Array
    skipped: int = 0
    stale: int = 0
    rejected: Mapping[str, int] = field(default_factory=dict)

    @property
    def ticks(self) -> int:
        return len(self.lateness)

    @property
    def drift(self) -> float:
        """How much later (s) the last ticks were than the first, by their medians; 0 for a run of one tick."""
        count = min(DRIFT_TICKS, self.ticks // 2)
        if count == 0:
            return 0.0
        return float(np.median(self.lateness[-count:]) - np.median(self.lateness[:count]))

    @property
    def sentence(self) -> str:
        """Why the run ended, in words."""
        return f"{self.reason.sentence}: {self.detail}" if self.detail else self.reason.sentence
