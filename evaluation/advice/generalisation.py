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

WORSE = 1.25
"""Test error over training error that must be exceeded for sure: two recordings of one kind differ by less."""
REMEMBERED = 0.02
"""A training error below this N is that of a model that looks its data up: it says nothing."""
HELPS = 1.05
"""Error with half the data over that with all, that must be exceeded for sure: a twentieth."""
PIECE = 200
"""Steps of each piece, of which every other one is left out."""


def overfit(evidence: Evidence) -> Remark | None:
    """Return that the error is larger where the model has not learned."""
    if evidence.test is None:
        return None
    seen, new = evidence.training_windows, evidence.test_windows
    if not len(seen.errors) or not len(new.errors):
        return None
    before, after = seen.n(evidence.std), new.n(evidence.std)
    if before < REMEMBERED:
        return None
    ratio = new.drawn_n(evidence.std, seed=1).times(seen.drawn_n(evidence.std, seed=2))
    if not ratio.low >= WORSE:
        return None
    return Remark(
        "overfit",
        f"The error of {evidence.name} in the test part is {after / before:.1f} times that in the training part (N "
        f"{after:.3f} and {before:.3f}, {_ahead(evidence)}): it has learned what does not last. Give it less to choose "
        "from or more noise on its inputs, record more, or see whether the test part is of another kind.",
        1.0 - before / after,
        {"test": after, "training": before},
    )


def too_few_data(evidence: Evidence, half: DynamicsModel) -> Remark | None:
    """Return that more data will help, as the error of ``half``, fitted to every other piece of the data, is larger."""
    whole, fewer = evidence.test_windows, window_errors(half, evidence.judged, evidence.horizon)
    paired = len(whole.errors) > 0 and np.array_equal(whole.blocks, fewer.blocks)
    if evidence.test is None or not paired:
        return None
    with_all, with_half = whole.n(evidence.std), fewer.n(evidence.std)
    if not fewer.drawn_n(evidence.std).times(whole.drawn_n(evidence.std)).low >= HELPS:
        return None
    return Remark(
        "few data",
        f"With half of the training data (every other {PIECE * evidence.system.dt:g} s) N of {evidence.name} is "
        f"{with_half:.3f}, with all {with_all:.3f} ({_ahead(evidence)}): it still learns. Record more of the same.",
        1.0 - with_all / with_half,
        {"half": with_half, "all": with_all},
    )


def halved(dataset: Dataset) -> Dataset:
    """Return every other piece of the data, so that both halves hold all that the recording does."""
    kept, number = [], 0
    for episode in dataset:
        for begin in range(0, len(episode), PIECE):
            if number % 2 == 0:
                kept.append(episode[begin : begin + PIECE])
            number += 1
    return dataset.with_episodes(kept)


def _ahead(evidence: Evidence) -> str:
    return f"{evidence.horizon * evidence.system.dt:g} s ahead"


BETTER = 0.1
"""Share of the error that a correction must take off, the gate at which adaptation pays at all."""
FEWEST, FEWEST_BLOCKS = 40, 4
"""Windows from which a correction is learned, and on which and on how many blocks of which it is judged."""
RIDGE = 3.0
NEIGHBOURS = 10


@dataclass(frozen=True)
class RecordingErrors:
    """Windows of all recordings: ``inputs`` (N, m) in standard deviations, ``errors`` (N, nx) likewise."""

    inputs: Array
    errors: Array
    recordings: np.ndarray
    blocks: IntArray
    first: BoolArray

    @classmethod
    def of(cls, evidence: Evidence) -> RecordingErrors:
        """Take those of training and test part; ``first`` are those in the first half of each recording."""
        parts = [evidence.training_windows]
        if evidence.test is not None:
            parts.append(evidence.test_windows)
        raw = np.concatenate([np.concatenate([part.states, part.pushes], axis=1) for part in parts])
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

    def correction(self, learned: BoolArray, judged: BoolArray) -> Array:
        """Return the correction (n, nx) of the rows ``judged``, linear in the inputs, by ridge regression."""
        x = np.concatenate([np.ones((int(learned.sum()), 1)), self.inputs[learned]], axis=1)
        weights = np.linalg.solve(x.T @ x + RIDGE * np.eye(x.shape[1]), x.T @ self.errors[learned])
        there = self.inputs[judged]
        return np.asarray(np.concatenate([np.ones((len(there), 1)), there], axis=1) @ weights)

    def nearby(self, learned: BoolArray, judged: BoolArray) -> tuple[Array, Array]:
        """Return the mean error (n, nx) of the nearest windows ``learned``, and how far (n,) the last of them is."""
        distances, near = cKDTree(self.inputs[learned]).query(self.inputs[judged], k=NEIGHBOURS)
        return self.errors[learned][np.asarray(near, dtype=np.int64)].mean(axis=1), np.asarray(distances)[:, -1]


def shift(evidence: Evidence) -> Remark | None:
    """Return which recording differs from the others.

    A correction of the error at the main horizon, linear in state and controls, is learned on the first half of each
    recording and judged on its second half; beside none, one learned on the others, and the mean error of the others'
    nearest windows. Only windows count that the others have the like of: other states are no other condition.
    """
    windows = RecordingErrors.of(evidence)
    gains = {}
    names = list(dict.fromkeys(windows.recordings))
    for name in names:
        gain = _gain(windows, windows.recordings == name, len(names))
        if gain is not None:
            gains[str(name)] = gain
    found = {name: gain for name, gain in gains.items() if gain >= BETTER}
    if not found:
        return None
    worst = max(found, key=lambda name: found[name])
    many = f" ({len(found)} of {len(gains)} recordings differ so)" if len(found) > 1 else ""
    return Remark(
        "shift",
        f"{worst} behaves unlike the other recordings{many}: a correction learned on its first half takes "
        f"{percent(found[worst])} off the error in its second half, and nothing learned on the others does. Adapt the "
        "model to the day it is used on, hold out whole recordings (--test), and record each condition for longer.",
        found[worst],
        {"gain": found[worst], "recordings": float(len(found))},
    )


def _gain(windows: RecordingErrors, own: BoolArray, recordings: int) -> float | None:
    """Return the share of the error that only an own correction takes off, 0 if that is luck; None if none can tell.

    It is one of so many ``recordings`` that are looked at.
    """
    others, learned, judged = ~own & windows.first, own & windows.first, own & ~windows.first
    if min(others.sum(), learned.sum(), judged.sum()) < FEWEST:
        return None
    mean, distance = windows.nearby(others, judged)
    usual = float(np.quantile(windows.nearby(others, ~own & ~windows.first)[1], 0.9))
    alike = distance <= usual
    blocks = windows.blocks[judged][alike]
    if alike.sum() < FEWEST or len(np.unique(blocks)) < FEWEST_BLOCKS:
        return None
    left = windows.errors[judged]
    rivals = (np.zeros_like(left), windows.correction(others, judged), mean)
    corrected = ((left - windows.correction(learned, judged)) ** 2)[alike]
    best = min((((left - rival) ** 2)[alike] for rival in rivals), key=lambda squares: _size(squares))
    if _size(best) == 0.0:
        return 0.0
    sure = _drawn(corrected, blocks).times(_drawn(best, blocks), figures=recordings).high < 1.0
    return 1.0 - _size(corrected) / _size(best) if sure else 0.0


def _size(squares: Array) -> float:
    return float(np.sqrt(squares.mean(axis=0)).mean())


def _drawn(squares: Array, blocks: IntArray) -> Draws:
    """Return the mean RMSE over channels with its draws of blocks."""
    return Draws(drawn_rms(np.sqrt(squares), blocks).mean(axis=1), len(np.unique(blocks)))
