"""Whether a correction is believed: free runs over blocks of the recording that it did not learn from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from sysid_evo.adaptation.pieces import error_of
from sysid_evo.arrays import Array, BoolArray, IntArray
from sysid_evo.data import Dataset
from sysid_evo.data.trajectory import Trajectory

BLOCKS = 3
BETTER = 0.10
"""Share by which the error must be lower than without a correction,"""
SHORT = 30.0
"""in a recording of so many seconds or more; in a shorter one, the more the shorter it is."""
NONE = "none"


@dataclass(frozen=True)
class Trial:
    """What one way to adapt was worth: its ``error`` over all blocks and in ``each`` (K,), as a share of none's."""

    name: str
    error: float
    each: tuple[float, ...]


@dataclass(frozen=True)
class Verdict:
    """What the gate saw and decided: the error without a correction, the trials, and the one that is taken.

    ``chosen`` is the name of a trial, or "none". ``needed`` is the share of improvement that was asked.
    """

    seconds: float
    blocks: int
    horizon: int
    plain: float
    trials: tuple[Trial, ...]
    needed: float
    chosen: str

    @property
    def sentence(self) -> str:
        """The decision in words."""
        if not self.blocks:
            return f"no correction: {self.seconds:.0f} s in motion are too short to hold a block back"
        best = min(self.trials, key=lambda trial: trial.error)
        seen = f"{100 * (1 - best.error):.0f} % better than none on {self.blocks} blocks it did not learn from"
        if self.chosen == NONE:
            return f"no correction: the best, {best.name}, is {seen}; {100 * self.needed:.0f} % are asked"
        taken = next(trial for trial in self.trials if trial.name == self.chosen)
        return (
            f"{self.chosen}: {100 * (1 - taken.error):.0f} % better than none on {self.blocks} blocks it did not "
            f"learn from"
        )


@dataclass(frozen=True)
class Block:
    """The samples ``low`` to ``high`` of a recording, held back while the rest is learned from."""

    low: int
    high: int
    horizon: int

    def held(self, first: IntArray) -> BoolArray:
        """Return which windows that begin at ``first`` (B,) lie inside."""
        return (first >= self.low) & (first + self.horizon <= self.high)

    def learned(self, first: IntArray) -> BoolArray:
        """Return which windows lie outside; one that reaches over an edge is on neither side."""
        return (first + self.horizon <= self.low) | (first >= self.high)

    def rest(self, dataset: Dataset) -> Dataset:
        """Return ``dataset`` without these samples."""
        kept: list[Trajectory] = []
        begin = 0
        for episode in dataset:
            low, high = (int(np.clip(edge - begin, 0, len(episode))) for edge in (self.low, self.high))
            kept += [episode[a:b] for a, b in ((0, low), (high, len(episode))) if b > a]
            begin += len(episode)
        return dataset.with_episodes(kept)


def blocks_of(first: IntArray, horizon: int) -> list[Block]:
    """Return three blocks of time with as many of the windows that begin at ``first`` (B,) each.

    None if one of them has no window to learn from, or none to be judged by.
    """
    edges = np.quantile(first, np.linspace(0.0, 1.0, BLOCKS + 1)).astype(int)
    edges[0], edges[-1] = 0, int(first.max()) + horizon
    blocks = [Block(low, high, horizon) for low, high in pairwise(edges.tolist())]
    return blocks if all(block.held(first).any() and block.learned(first).any() for block in blocks) else []


def needed(seconds: float) -> float:
    """Return by which share a correction learned from ``seconds`` must be better than none."""
    return float(min(0.5, BETTER * max(1.0, SHORT / max(seconds, 1e-9))))


def judged(name: str, plain: Sequence[Array], errors: Sequence[Array]) -> Trial:
    """Return a trial from the errors (B, H, nx) of each block without and with a correction."""
    each = tuple(error_of(one) / max(error_of(other), 1e-12) for one, other in zip(errors, plain, strict=True))
    whole = error_of(np.concatenate(list(errors))) / max(error_of(np.concatenate(list(plain))), 1e-12)
    return Trial(name, whole, each)


def decided(trials: Sequence[Trial], asked: float) -> str:
    """Return the name of the best trial that is good enough and not worse than none in any block; "none" without."""
    good = [trial for trial in trials if trial.error <= 1.0 - asked and max(trial.each) <= 1.0]
    return min(good, key=lambda trial: trial.error).name if good else NONE
