"""The inner validation that every family shares: blocks of time, judged by simulation over one second."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

from sysid_evo.data import Dataset, Windows
from sysid_evo.data.trajectory import Trajectory
from sysid_evo.dynamics import DynamicsModel

BLOCKS = 6
SHORTEST = 30
Choice = TypeVar("Choice")


def time_blocks(dataset: Dataset, fold: int = 0, folds: int = 3) -> tuple[Dataset, Dataset]:
    """Return what is learned from and what is held out: every ``folds``-th block of time of each episode.

    An episode is cut into 6 blocks, fewer if they were shorter than 30 steps; one too short to be
    cut is only learned from. If nothing can be held out, both sides are the whole data set.
    """
    learned: list[Trajectory] = []
    held: list[Trajectory] = []
    for number, episode in enumerate(dataset.episodes):
        blocks = min(BLOCKS, len(episode) // SHORTEST)
        if blocks < 2:
            learned.append(episode)
            continue
        edges = np.linspace(0, len(episode), blocks + 1).astype(int)
        out = [(block + number) % min(folds, blocks) == fold % min(folds, blocks) for block in range(blocks)]
        begin = 0
        for block in range(1, blocks + 1):
            if block == blocks or out[block] != out[begin]:
                (held if out[begin] else learned).append(episode[int(edges[begin]) : int(edges[block])])
                begin = block
    if not held or not learned:
        return dataset, dataset
    return dataset.with_episodes(learned), dataset.with_episodes(held)


def diverges(model: DynamicsModel, windows: Windows, training: Dataset) -> bool:
    """Whether a free run reaches twice the largest training value of a channel, or the model's own clip."""
    largest = 2.0 * np.abs(np.concatenate([episode.states for episode in training.episodes])).max(axis=0)
    simulated = model.simulate(windows.past_states, windows.past_controls, windows.controls)
    low, high = model.envelope_
    return bool(((np.abs(simulated) >= largest) | (simulated <= low) | (simulated >= high)).any())


def best(candidates: Sequence[Choice], error: Callable[[Choice], float]) -> Choice:
    """Return the candidate with the lowest error, the first among equals."""
    errors = [error(candidate) for candidate in candidates]
    return candidates[int(np.argmin(errors))]


def lag_candidates(
    state_lags: int | None,
    control_lags: int | None,
    offered: Sequence[tuple[int, int]] = ((0, 0), (0, 3), (1, 3), (2, 4)),
) -> list[tuple[int, int]]:
    """Return the pairs of state and control lags to try: those ``offered``, with what is given kept fixed."""
    pairs = [
        (states if state_lags is None else state_lags, controls if control_lags is None else control_lags)
        for states, controls in offered
    ]
    return list(dict.fromkeys(pairs))
