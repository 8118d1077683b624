"""Acceptance test of adaptation candidates, and margins within which candidates count as equal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from sysid_evo.types import Array, BoolArray, IntArray
from sysid_evo.validation.estimates import Estimate, paired
from sysid_evo.validation.simulation_error import error_of

MIN_IMPROVEMENT = 0.15
"""Required reduction of the error over all blocks, as a share of the uncorrected error."""
MAX_BLOCK_INCREASE = 0.1
"""Largest increase of the error in a block. The evidence is pooled over the blocks: the mean difference of the errors,
interval by interval, must be significant, see `paired`."""
TRAINING_IMPROVEMENT = 1.0
"""Required reduction for fine-tuned models and means with them, which can learn much from little data: this divided by
the square root of the number of intervals (19 % for 28, 38 % for 7), but at least `MIN_IMPROVEMENT`."""
N_AMOUNTS = 3
"""Number of amounts of fine-tuning that are tested together (Bonferroni); each needs a probability of about 99 %."""

MIN_INTERVALS = 3
"""Least number of intervals to compare."""

MIN_ERROR = 1e-12
"""Lower bound of an error in a denominator."""

AND = " and "
"""Separates the names of the two models of a mean."""
Kind: TypeAlias = Literal["fit", "fine_tuned", "fine_tuned_mean", "fit_mean"]
"""Kind of a candidate: a correction or another fit, a fine-tuned model, or the mean of one of these and a correction.
"""


@dataclass(frozen=True)
class HeldOutErrors:
    """The errors (B, H, nx) of simulations of a held-out block, and the interval of time in which each begins (B,).

    An interval is a second, or the length of a simulation if that is more.
    """

    errors: Array
    interval: IntArray

    def sizes(self) -> dict[int, float]:
        """Return the root mean square of the errors of the simulations that begin in each interval."""
        mean = np.mean(self.errors**2, axis=(1, 2))
        return {int(one): float(np.sqrt(mean[self.interval == one].mean())) for one in np.unique(self.interval)}

    def share_of(self, before: HeldOutErrors) -> float:
        """Return the error as a share of the error ``before``."""
        return error_of(self.errors) / max(error_of(before.errors), MIN_ERROR)


@dataclass(frozen=True)
class AcceptanceResult:
    """The ``error`` of a candidate over all blocks and in ``each`` (K,), as a share of the uncorrected error.

    There are fewer blocks if it was dropped after it had `failed` in one. ``sure``: the improvement is statistically
    significant; ``required``: the least improvement, as a share of the error.
    """

    name: str
    error: float
    each: tuple[float, ...]
    sure: bool
    kind: Kind = "fit"
    required: float = MIN_IMPROVEMENT

    @property
    def other(self) -> str:
        """The name of the second model of a mean."""
        return self.name.rpartition(AND)[2]

    @property
    def good(self) -> bool:
        """Whether the improvement is large enough and significant, and no block has become much worse."""
        return self.sure and self.error <= 1.0 - self.required and self.consistent

    @property
    def consistent(self) -> bool:
        """Whether no block has become much worse."""
        return max(self.each) <= 1.0 + MAX_BLOCK_INCREASE


def acceptance_result(
    name: str, uncorrected: Sequence[HeldOutErrors], corrected: Sequence[HeldOutErrors], kind: Kind = "fit"
) -> AcceptanceResult:
    """Return the result for the errors in all blocks without a correction, and in all or the first blocks with it."""
    pairs = list(zip(uncorrected, corrected, strict=False))
    each = tuple(after.share_of(before) for before, after in pairs)
    whole = error_of(np.concatenate([after.errors for _, after in pairs]))
    before = error_of(np.concatenate([before.errors for before, _ in pairs]))
    gains = []
    for one, other in pairs:
        first, second = one.sizes(), other.sizes()
        gains += [first[key] - second[key] for key in first.keys() & second.keys()]
    required, tried = MIN_IMPROVEMENT, 1
    if kind in ("fine_tuned", "fine_tuned_mean"):
        required, tried = max(MIN_IMPROVEMENT, TRAINING_IMPROVEMENT / np.sqrt(max(1, len(gains)))), N_AMOUNTS
    sure = len(gains) >= MIN_INTERVALS and surely_more(paired(np.array(gains), figures=tried))
    return AcceptanceResult(name, whole / max(before, MIN_ERROR), each, sure, kind, float(required))


def failed(uncorrected: Sequence[HeldOutErrors], corrected: Sequence[HeldOutErrors]) -> bool:
    """Whether one of the blocks in ``corrected`` has become much worse."""
    return any(
        after.share_of(before) > 1.0 + MAX_BLOCK_INCREASE for before, after in zip(uncorrected, corrected, strict=False)
    )


def surely_more(gain: Estimate, margin: float = 0.0) -> bool:
    """Whether a gain exceeds ``margin`` and is significantly above zero."""
    return bool(gain.value > margin and gain.low > 0.0)


def inside(errors: Sequence[float], cutoff: float) -> list[int]:
    """Return the indices of errors that are at most ``cutoff`` times the lowest, in their order."""
    found: list[int] = np.flatnonzero(within_margin(np.array(errors), min(errors), cutoff - 1.0)).tolist()
    return found


def within_margin(losses: Array, reference: float, margin: float) -> BoolArray:
    """Return which ``losses`` (N,), errors or negative fitness, exceed ``reference`` by at most ``margin`` times it."""
    return np.isfinite(losses) & (losses <= reference + margin * abs(reference))
