"""What a controller claims where it was evolved, how sure that is, and when the claim is exploited."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from evaluation.transfer.matrix import TransferMatrix
from sysid_evo.arrays import Array
from sysid_evo.evolution import Champion
from sysid_evo.registry import make_aggregate

RESAMPLES = 1000
LEAST_GAP = 0.1
"""A claim is exploited only if the gap is more than this share of it."""
SURE = 2.0
"""A claim is exploited only if the gap is more than this many standard errors."""
ENDS = (0.05, 0.95)
"""Quantiles of the draws between which a 90 % interval lies."""
UNKNOWN = math.nan


@dataclass(frozen=True)
class Estimate:
    """A fitness, or a difference of two, its standard error and 90 % interval (nan for one trial, and if not known)."""

    value: float
    standard_error: float
    low: float = UNKNOWN
    high: float = UNKNOWN

    @classmethod
    def of(cls, draws: Array | None) -> Estimate | None:
        """Take the value and the spread of the draws behind it, (1 + draws,)."""
        if draws is None:
            return None
        low, high = np.quantile(draws[1:], ENDS)
        return cls(float(draws[0]), float(draws[1:].std()), float(low), float(high))


def fitness_on(champion: Champion, columns: Sequence[str], matrix: TransferMatrix, *, seed: int = 0) -> Array | None:
    """Return a controller's fitness on ``columns``, then that of every bootstrap draw of trials, (1 + RESAMPLES,).

    On the models it was evolved against this is its claim. Several systems are made one by the rule of its
    evolution; one system goes through the same rule, so that any two of these figures can be compared. None
    unless the controller was run on all of them.

    Each of E trials is drawn E - 1 times, which makes the spread of a mean that of n - 1 (Rao and Wu 1988).
    Systems with as many trials meet the same draws, so that differences between them are paired. A single
    trial has no spread: its draws are nan.
    """
    cells = [matrix.cell(champion.name, column) for column in columns if column in matrix.columns]
    if not cells or len(cells) < len(columns) or any(cell.failed for cell in cells):
        return None
    trials = min(cell.trials for cell in cells)
    fitness = np.stack([cell.fitness[:trials] for cell in cells])
    rule = make_aggregate(champion.aggregate)
    value = rule(fitness[:, None])
    if trials < 2:
        return np.concatenate([value, np.full(RESAMPLES, np.nan)])
    picks = np.random.default_rng(seed).integers(0, trials, (RESAMPLES, trials - 1))
    return np.concatenate([value, rule(fitness[:, picks])])


def is_exploited(claimed: Estimate | None, gap: Estimate | None) -> bool | None:
    """Say whether a claim exceeds what is achieved elsewhere by a tenth of it and by two standard errors.

    None where nothing is claimed, there is nowhere else, or a single trial leaves the error unknown.
    """
    if claimed is None or gap is None or not np.isfinite(gap.standard_error):
        return None
    return gap.value > max(LEAST_GAP * abs(claimed.value), SURE * gap.standard_error)
