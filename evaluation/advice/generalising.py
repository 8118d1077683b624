"""Whether a model has learned too much from too little: training against test error, and half of the data."""

from __future__ import annotations

import numpy as np

from evaluation.advice.evidence import Evidence, WindowErrors, window_errors
from evaluation.advice.remark import Remark
from evaluation.prediction.bootstrap import interval
from sysid_evo.data import Dataset
from sysid_evo.dynamics import DynamicsModel

WORSE = 1.25
"""Test error over training error that must be exceeded for sure: two recordings of one kind differ by less."""
REMEMBERED = 0.02
"""A training error below this N is that of a model that looks its data up: it says nothing."""
HELPS = 1.05
"""Error with half the data over that with all, that must be exceeded for sure: a twentieth."""
PIECE = 200
"""Steps of each piece, of which every other one is left out."""
CONFIDENCE = 0.95


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
    ratios = new.drawn_n(evidence.std, seed=1) / seen.drawn_n(evidence.std, seed=2)
    if interval(ratios, CONFIDENCE).low < WORSE:
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
    if evidence.test is None or not _paired(whole, fewer):
        return None
    with_all, with_half = whole.n(evidence.std), fewer.n(evidence.std)
    ratios = fewer.drawn_n(evidence.std) / whole.drawn_n(evidence.std)
    if interval(ratios, CONFIDENCE).low < HELPS:
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


def _paired(first: WindowErrors, second: WindowErrors) -> bool:
    return len(first.errors) > 0 and np.array_equal(first.blocks, second.blocks)


def _ahead(evidence: Evidence) -> str:
    return f"{evidence.horizon * evidence.system.dt:g} s ahead"
