"""Whether a candidate is better: acceptance test, margins, simplest of those about as good."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from sysid_evo.types import Array, BoolArray, IntArray
from sysid_evo.validation.estimates import Estimate, paired
from sysid_evo.validation.simulation_error import error_of

BETTER = 0.15
"""Share by which the error must be lower than without a correction,"""
IN_EACH = 0.05
"""that by which it must be lower in every block (second by second it must be surely lower, too, see `paired`),"""
BETTER_OF_TRAINING = 1.0
"""and the share for more training and for means, of which many are tried and each can learn much from little: this over
the root of the seconds that are compared (19 % of 28, 38 % of 7), and `BETTER` at least;"""
AMOUNTS = 3
"""and so many amounts of training are looked at together, each as sure as that takes (Bonferroni): some 99 %."""

FEWEST = 3
"""Seconds that must be compared."""

LEAST = 1e-12
"""An error that others are divided by is no smaller."""

AND = " and "
"""Between the two of a mean."""
Kind: TypeAlias = Literal["alone", "further", "mean", "beside"]
"""Whether a trial is a correction or another fit, more training of the model that there was, the mean of such training
and a correction, or the mean of another fit and a correction."""


@dataclass(frozen=True)
class HeldOutErrors:
    """The errors (B, H, nx) of free runs over a block that was held back, and the second in which each begins (B,)."""

    errors: Array
    second: IntArray

    def squares(self) -> dict[int, float]:
        """Return the mean square of the errors of the runs that begin in each second."""
        mean = np.mean(self.errors**2, axis=(1, 2))
        return {int(second): float(mean[self.second == second].mean()) for second in np.unique(self.second)}

    def share_of(self, before: HeldOutErrors) -> float:
        """Return the error as a share of that ``before``."""
        return error_of(self.errors) / max(error_of(before.errors), LEAST)


@dataclass(frozen=True)
class AcceptanceResult:
    """What one way to adapt was worth: its ``error`` over all blocks and in ``each`` (K,), as a share of none's.

    The blocks are fewer where it was given up before the last, since it had `failed` in one. ``sure`` says whether it
    is better than none beyond what chance would do to so short a recording, ``asked`` by what share it must be.
    """

    name: str
    error: float
    each: tuple[float, ...]
    sure: bool
    kind: Kind = "alone"
    asked: float = BETTER

    @property
    def other(self) -> str:
        """The second of a mean."""
        return self.name.rpartition(AND)[2]

    @property
    def good(self) -> bool:
        """Whether it is better by enough, surely, and in every block."""
        return self.sure and self.error <= 1.0 - self.asked and self.everywhere

    @property
    def everywhere(self) -> bool:
        """Whether it is better in every block."""
        return max(self.each) <= 1.0 - IN_EACH


def judged(
    name: str, plain: Sequence[HeldOutErrors], corrected: Sequence[HeldOutErrors], kind: Kind = "alone"
) -> AcceptanceResult:
    """Return a trial from what the blocks show without and with a correction, which may know the first ones only."""
    pairs = list(zip(plain, corrected, strict=False))
    each = tuple(after.share_of(before) for before, after in pairs)
    whole = error_of(np.concatenate([after.errors for _, after in pairs]))
    before = error_of(np.concatenate([before.errors for before, _ in pairs]))
    gains = []
    for one, other in pairs:
        first, second = one.squares(), other.squares()
        gains += [first[key] - second[key] for key in first.keys() & second.keys()]
    asked, tried = BETTER, 1
    if kind in ("further", "mean"):
        asked, tried = max(BETTER, BETTER_OF_TRAINING / np.sqrt(max(1, len(gains)))), AMOUNTS
    sure = len(gains) >= FEWEST and surely_more(paired(np.array(gains), figures=tried))
    return AcceptanceResult(name, whole / max(before, LEAST), each, sure, kind, float(asked))


def failed(plain: Sequence[HeldOutErrors], corrected: Sequence[HeldOutErrors]) -> bool:
    """Whether a correction is not better by enough in one of the blocks that it has been judged by."""
    return any(after.share_of(before) > 1.0 - IN_EACH for before, after in zip(plain, corrected, strict=False))


def surely_more(gain: Estimate, margin: float = 0.0) -> bool:
    """Whether a gain exceeds ``margin``, and is above zero by more than chance explains."""
    return bool(gain.value > margin and gain.low > 0.0)


def inside(errors: Sequence[float], gate: float) -> list[int]:
    """Return the numbers of those whose error is at most ``gate`` times the lowest, in their order."""
    found: list[int] = np.flatnonzero(within_margin(np.array(errors), min(errors), gate - 1.0)).tolist()
    return found


def within_margin(losses: Array, reference: float, margin: float) -> BoolArray:
    """Return which ``losses`` (N,), errors or negative fitness, exceed ``reference`` by at most that share of it."""
    return np.isfinite(losses) & (losses <= reference + margin * abs(reference))
