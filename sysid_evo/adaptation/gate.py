"""Whether a correction is believed: free runs over blocks of the recording that it did not learn from."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, TypeAlias

import numpy as np
from scipy.special import stdtrit

from sysid_evo.adaptation.pieces import error_of
from sysid_evo.arrays import Array, BoolArray, IntArray
from sysid_evo.data import Dataset
from sysid_evo.data.trajectory import Trajectory

BLOCKS = 3
BETTER = 0.15
"""Share by which the error must be lower than without a correction,"""
IN_EACH = 0.05
"""that by which it must be lower in every block,"""
CONFIDENCE = 0.975
"""and the probability that it is lower at all, from the differences second by second (Student's t);"""
BETTER_OF_TRAINING, CONFIDENCE_OF_TRAINING = 1.0, 0.99
"""those of more training and of means, of which many are tried and each can learn much from little: this share is
divided by the root of the seconds that are compared (19 % of 28, 38 % of 7), and is `BETTER` at least."""
AS_GOOD = 0.10
"""Share of the lowest error by which a simpler correction may be worse."""
NONE = "none"
AND = " and "
"""Between the two of a mean."""
Kind: TypeAlias = Literal["alone", "further", "mean", "beside"]
"""Whether a trial is a correction or another fit, more training of the model that there was, the mean of such training
and a correction, or the mean of another fit and a correction."""


@dataclass(frozen=True)
class Held:
    """The errors (B, H, nx) of free runs over a block that was held back, and the second in which each begins (B,)."""

    errors: Array
    second: IntArray

    def squares(self) -> dict[int, float]:
        """Return the mean square of the errors of the runs that begin in each second."""
        mean = np.mean(self.errors**2, axis=(1, 2))
        return {int(second): float(mean[self.second == second].mean()) for second in np.unique(self.second)}


@dataclass(frozen=True)
class Trial:
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


_NOTHING = Trial(NONE, 1.0, (1.0,), sure=False)


@dataclass(frozen=True)
class Verdict:
    """What the gate saw and decided: the error without a correction, the trials, and the one that is taken.

    ``chosen`` is the name of a trial, or "none". ``times_home`` is given where nothing was tried, as the model is in no
    state more than so many times farther off than on what was held out from its training.
    """

    seconds: float
    blocks: int
    plain: float
    trials: tuple[Trial, ...]
    chosen: str
    times_home: float | None = None

    @property
    def sentence(self) -> str:
        """The decision in words."""
        if self.times_home is not None:
            return (
                "no correction: nothing much has shifted, free runs of a second are in no state more than "
                f"{self.times_home:.2f} times as far off as on what was held out from the training"
            )
        if not self.trials:
            return f"no correction: {self.seconds:.0f} s in motion are too short to hold a block back"
        taken = next((trial for trial in self.trials if trial.name == self.chosen), None)
        whole = [trial for trial in self.trials if len(trial.each) == self.blocks]
        best = min(whole, key=lambda trial: trial.error) if taken is None else taken
        change = 100.0 * (1.0 - best.error)
        seen = f"{abs(change):.0f} % {'better' if change > 0 else 'worse'} than none on {self.blocks} blocks"
        if taken is not None:
            return f"{taken.name}: {seen} it did not learn from"
        why = f"{100 * best.asked:.0f} % are asked"
        if change >= 100.0 * best.asked:
            why = "which may be chance" if best.everywhere else "but not on each of them"
        return f"no correction: the best, {best.name}, is {seen} it did not learn from; {why}"


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
        for episode, low, high in self._edges(dataset):
            kept += [episode[a:b] for a, b in ((0, low), (high, len(episode))) if b > a]
        return dataset.with_episodes(kept)

    def part(self, dataset: Dataset) -> Dataset:
        """Return these samples of ``dataset``."""
        return dataset.with_episodes([episode[low:high] for episode, low, high in self._edges(dataset) if high > low])

    def _edges(self, dataset: Dataset) -> Iterator[tuple[Trajectory, int, int]]:
        """Yield every episode and where the block begins and ends in it."""
        begin = 0
        for episode in dataset:
            low, high = (int(np.clip(edge - begin, 0, len(episode))) for edge in (self.low, self.high))
            yield episode, low, high
            begin += len(episode)


def blocks_of(first: IntArray, horizon: int) -> list[Block]:
    """Return three blocks of time with as many of the windows that begin at ``first`` (B,) each.

    None if one of them has no window to learn from, or none to be judged by.
    """
    edges = np.quantile(first, np.linspace(0.0, 1.0, BLOCKS + 1)).astype(int)
    edges[0], edges[-1] = 0, int(first.max()) + horizon
    blocks = [Block(low, high, horizon) for low, high in pairwise(edges.tolist())]
    return blocks if all(block.held(first).any() and block.learned(first).any() for block in blocks) else []


def judged(name: str, plain: Sequence[Held], corrected: Sequence[Held], kind: Kind = "alone") -> Trial:
    """Return a trial from what the blocks show without and with a correction, which may know the first ones only."""
    pairs = list(zip(plain, corrected, strict=False))
    each = tuple(_share(before, after) for before, after in pairs)
    whole = error_of(np.concatenate([after.errors for _, after in pairs]))
    before = error_of(np.concatenate([before.errors for before, _ in pairs]))
    gains = []
    for one, other in pairs:
        first, second = one.squares(), other.squares()
        gains += [first[key] - second[key] for key in first.keys() & second.keys()]
    asked, confidence = BETTER, CONFIDENCE
    if kind in ("further", "mean"):
        asked, confidence = max(BETTER, BETTER_OF_TRAINING / np.sqrt(max(1, len(gains)))), CONFIDENCE_OF_TRAINING
    sure = surely_positive(np.array(gains), confidence)
    return Trial(name, whole / max(before, 1e-12), each, sure, kind, float(asked))


def failed(plain: Sequence[Held], corrected: Sequence[Held]) -> bool:
    """Whether a correction is not better by enough in one of the blocks that it has been judged by."""
    return any(_share(*pair) > 1.0 - IN_EACH for pair in zip(plain, corrected, strict=False))


def _share(before: Held, after: Held) -> float:
    """Return the error in a block as a share of that without a correction."""
    return error_of(after.errors) / max(error_of(before.errors), 1e-12)


def surely_positive(gains: Array, confidence: float = CONFIDENCE) -> bool:
    """Whether the mean of ``gains`` (N,) is above zero by more than chance explains."""
    if len(gains) < 3:
        return False
    error = gains.std(ddof=1) / np.sqrt(len(gains))
    return bool(gains.mean() > stdtrit(len(gains) - 1, confidence) * error)


def decided(trials: Sequence[Trial]) -> str:
    """Return the name of what is best; "none" if nothing is good.

    Of corrections and other fits the first, which is the simplest, of those about as good as the best stands for all.
    More training, alone and in a mean with a correction, is no simpler and no less simple than these: the best of it is
    taken if it is better. Where another fit is taken, its mean with a correction takes its place if it is about as
    good: what learned from few seconds alone knows nothing of what they do not cover.
    """
    good = [trial for trial in trials if trial.good]
    alone = [trial for trial in good if trial.kind == "alone"]
    least = min((trial.error for trial in alone), default=0.0)
    simplest = [trial for trial in alone if trial.error <= (1.0 + AS_GOOD) * least][:1]
    found = [*simplest, *(trial for trial in good if trial.kind in ("further", "mean"))]
    best = min(found, key=lambda trial: trial.error, default=_NOTHING)
    beside = [trial for trial in good if trial.kind == "beside" and trial.other == best.name]
    safer = [trial for trial in beside if trial.error <= (1.0 + AS_GOOD) * best.error]
    return safer[0].name if safer else best.name
