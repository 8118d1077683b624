"""What is held out in turn: whole recordings, or blocks of time where there is one."""

from __future__ import annotations

import numpy as np

from model_zoo.validation.held_out import time_blocks
from sysid_evo.cross_validation import EpisodeFold, recording
from sysid_evo.data import Dataset

LEAST_SHARE = 0.5
"""Of the steps that must be left to learn from where a group of recordings is held out."""


def folds_of(dataset: Dataset, count: int) -> list[tuple[Dataset, Dataset]]:
    """Return up to ``count`` pairs of what is learned from and what is held out.

    Whole recordings are held out, in groups where there are more than ``count``; pieces of one stay together. Of a
    single recording, or where one is so long that too little would be left without it, blocks of time.
    """
    recordings = len({recording(name) for name in dataset.names})
    if recordings >= 2:
        groups = EpisodeFold(min(max(count, 2), recordings)).split(dataset)
        pairs = [(dataset[list(seen)], dataset[list(held)]) for seen, held in groups]
        if all(seen.n_steps >= LEAST_SHARE * dataset.n_steps * (1.0 - 1.0 / len(pairs)) for seen, _ in pairs):
            return pairs[:count]
    pairs = [time_blocks(dataset, fold, max(count, 2)) for fold in range(count)]
    return [pair for pair in pairs if pair[0] is not pair[1]] or pairs[:1]


def horizons_of(pairs: list[tuple[Dataset, Dataset]], wanted: list[int]) -> list[int]:
    """Return those of the ``wanted`` horizons (steps) that fit into what is held out; the longest possible if none."""
    longest = min(max(len(episode) for episode in held) for _, held in pairs)
    fitting = sorted({horizon for horizon in wanted if horizon <= longest - 1})
    return fitting or [max(1, longest // 2)]


def history_of(pairs: list[tuple[Dataset, Dataset]]) -> int:
    """Return how many samples are measured before a free run: more where recordings are long."""
    typical = float(np.median([len(episode) for _, held in pairs for episode in held]))
    return int(np.clip(typical // 20, 0, 64))
