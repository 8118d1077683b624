"""Checks on other data: overfitting, too few data, recordings that differ."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from evaluation.advice.evidence import Evidence, Remark, window_errors
from evaluation.formatting import percent
from sysid_evo.data import Dataset
from sysid_evo.models import DynamicsModel
from sysid_evo.types import Array, BoolArray, IntArray
from sysid_evo.validation.estimates import Draws, drawn_rms

MIN_ERROR_RATIO = 1.25
"""Ratio of test to training error that must be exceeded with certainty: similar recordings differ by less."""
MEMORISED_ERROR = 0.02
"""A training error N below this belongs to a model that memorises its data; it is not compared."""
MIN_GAIN_RATIO = 1.05
"""Ratio of the error with half the data to that with all data which must be exceeded with certainty."""
BLOCK_STEPS = 200
"""Steps of each block; every other block is left out."""


def overfit(evidence: Evidence) -> Remark | None:
    """Return a remark if the error is larger on data that the model was not fitted to."""
    if evidence.test is None:
        return None
    seen, new = evidence.training_windows, evidence.test_windows
    if not len(seen.errors) or not len(new.errors):
        return None
    before, after = seen.n(evidence.std), new.n(evidence.std)
    if before < MEMORISED_ERROR:
        return None
    ratio = new.drawn_n(evidence.std, seed=1).times(seen.drawn_n(evidence.std, seed=2))
    if not ratio.low >= MIN_ERROR_RATIO:
        return None
    return Remark(
        "overfit",
        f"The error of {evidence.name} in the test part is {after / before:.1f} times its training error (N "
        f"{after:.3f} and {before:.3f}, {_ahead(evidence)}): it overfits. Use a simpler model or more noise on its "
        "inputs, record more, or check whether the test part was recorded under other conditions.",
        1.0 - before / after,
        {"test": after, "training": before},
    )


def too_few_data(evidence: Evidence, half: DynamicsModel) -> Remark | None:
    """Return a remark if more data would help: ``half``, fitted to every other block, has a larger error."""
    whole, fewer = evidence.test_windows, window_errors(half, evidence.evaluated, evidence.horizon)
    paired = len(whole.errors) > 0 and np.array_equal(whole.blocks, fewer.blocks)
    if evidence.test is None or not paired:
        return None
    with_all, with_half = whole.n(evidence.std), fewer.n(evidence.std)
    if not fewer.drawn_n(evidence.std).times(whole.drawn_n(evidence.std)).low >= MIN_GAIN_RATIO:
        return None
    return Remark(
        "few data",
        f"With half of the training data (every other {BLOCK_STEPS * evidence.system.dt:g} s) N of {evidence.name} is "
        f"{with_half:.3f}, with all {with_all:.3f} ({_ahead(evidence)}): more data will help. Record more of the same.",
        1.0 - with_all / with_half,
        {"half": with_half, "all": with_all},
    )


def halved(dataset: Dataset) -> Dataset:
    """Return every other block of the data, so that both halves cover the whole recording."""
    kept, number = [], 0
    for episode in dataset:
        for begin in range(0, len(episode), BLOCK_STEPS):
            if number % 2 == 0:
                kept.append(episode[begin : begin + BLOCK_STEPS])
            number += 1
    return dataset.with_episodes(kept)


def _ahead(evidence: Evidence) -> str:
    return f"{evidence.horizon * evidence.system.dt:g} s ahead"


MIN_CORRECTION = 0.1
"""Share of the error that a correction must remove; below it adaptation does not pay."""
FEWEST, FEWEST_BLOCKS = 40, 4
"""Minimum number of windows to fit a correction to and to evaluate it on, and of blocks to evaluate it on."""
RIDGE = 3.0
NEIGHBOURS = 10


@dataclass(frozen=True)
class RecordingErrors:
    """Windows of all recordings: ``inputs`` (N, m) and ``errors`` (N, nx), both in standard deviations."""

    inputs: Array
    errors: Array
    recordings: np.ndarray
    blocks: IntArray
    first: BoolArray

    @classmethod
    def of(cls, evidence: Evidence) -> RecordingErrors:
        """Return the windows of training and test part; ``first`` marks those in the first half of each recording."""
        parts = [evidence.training_windows]
        if evidence.test is not None:
            parts.append(evidence.test_windows)
        raw = np.concatenate([np.concatenate([part.states, part.mean_controls], axis=1) for part in parts])
        std = raw.std(axis=0)
        recordings = np.concatenate([part.recordings for part in parts])
        first = np.zeros(len(raw), dtype=bool)
        for name in set(recordings):
            own = np.flatnonzero(recordings == name)
            first[own[: len(own) // 2]] = True
        after = 1 + max((int(part.blocks.max(initial=0)) for part in parts), default=0)
        blocks = np.concatenate([part.blocks + number * after for number, part in enumerate(parts)])
        inputs = (raw - raw.mean(axis=0)) / np.where(std > 0.0, std, np.inf)
        return cls(inputs, np.concatenate([part.errors for part in parts]) / evidence.std, recordings, blocks, first)

    def correction(self, learned: BoolArray, evaluated: BoolArray) -> Array:
        """Return a correction (n, nx) of the rows ``evaluated``, linear in the inputs, by ridge regression."""
        x = np.concatenate([np.ones((int(learned.sum()), 1)), self.inputs[learned]], axis=1)
        weights = np.linalg.solve(x.T @ x + RIDGE * np.eye(x.shape[1]), x.T @ self.errors[learned])
        there = self.inputs[evaluated]
        return np.asarray(np.concatenate([np.ones((len(there), 1)), there], axis=1) @ weights)

    def nearby(self, learned: BoolArray, evaluated: BoolArray) -> tuple[Array, Array]:
        """Return the mean error (n, nx) of the nearest windows ``learned``, and how far (n,) the last is."""
        distances, near = cKDTree(self.inputs[learned]).query(self.inputs[evaluated], k=NEIGHBOURS)
        return self.errors[learned][np.asarray(near, dtype=np.int64)].mean(axis=1), np.asarray(distances)[:, -1]


def shift(evidence: Evidence) -> Remark | None:
    """Return a remark on a recording that differs from the others.

    A correction of the error at the main horizon, linear in state and controls, is fitted to the first half of each
    recording and evaluated on its second half. It is compared with no correction, a correction fitted to the other
    recordings, and the mean error of the nearest windows of the others. Only windows count for which the others
    contain similar ones: different states are not a different condition.
    """
    windows = RecordingErrors.of(evidence)
    gains = {}
    names = list(dict.fromkeys(windows.recordings))
    for name in names:
        gain = _gain(windows, windows.recordings == name, len(names))
        if gain is not None:
            gains[str(name)] = gain
    found = {name: gain for name, gain in gains.items() if gain >= MIN_CORRECTION}
    if not found:
        return None
    worst = max(found, key=lambda name: found[name])
    many = f" ({len(found)} of {len(gains)} recordings differ)" if len(found) > 1 else ""
    return Remark(
        "shift",
        f"{worst} differs from the other recordings{many}: a correction fitted to its first half lowers the error in "
        f"its second half by {percent(found[worst])}, and corrections fitted to the others do not. Adapt the model to "
        "the condition it is used in, hold out whole recordings (--test), and record each condition for longer.",
        found[worst],
        {"gain": found[worst], "recordings": float(len(found))},
    )


def _gain(windows: RecordingErrors, own: BoolArray, recordings: int) -> float | None:
    """Return the share of the error that only an own correction removes, 0 if by chance; None if it is not known.

    ``recordings`` is the number of recordings that are tested.
    """
    others, learned, evaluated = ~own & windows.first, own & windows.first, own & ~windows.first
    if min(others.sum(), learned.sum(), evaluated.sum()) < FEWEST:
        return None
    mean, distance = windows.nearby(others, evaluated)
    usual = float(np.quantile(windows.nearby(others, ~own & ~windows.first)[1], 0.9))
    similar = distance <= usual
    blocks = windows.blocks[evaluated][similar]
    if similar.sum() < FEWEST or len(np.unique(blocks)) < FEWEST_BLOCKS:
        return None
    left = windows.errors[evaluated]
    rivals = (np.zeros_like(left), windows.correction(others, evaluated), mean)
    corrected = ((left - windows.correction(learned, evaluated)) ** 2)[similar]
    best = min((((left - rival) ** 2)[similar] for rival in rivals), key=lambda squares: _size(squares))
    if _size(best) == 0.0:
        return 0.0
    sure = _drawn(corrected, blocks).times(_drawn(best, blocks), figures=recordings).high < 1.0
    return 1.0 - _size(corrected) / _size(best) if sure else 0.0


def _size(squares: Array) -> float:
    return float(np.sqrt(squares.mean(axis=0)).mean())


def _drawn(squares: Array, blocks: IntArray) -> Draws:
    """Return the mean RMSE over channels with bootstrap draws over blocks."""
    return Draws(drawn_rms(np.sqrt(squares), blocks).mean(axis=1), len(np.unique(blocks)))
