"""The inner validation that every family shares: blocks of time, judged by simulation over one second."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.data import Dataset, Windows
from sysid_evo.data.trajectory import Trajectory
from sysid_evo.dynamics import DynamicsModel
from sysid_evo.errors import InvalidData

BLOCKS = 6
SHORTEST = 30
HORIZON_TIME = 1.0  # s
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


def validation_windows(dataset: Dataset, history: int, *, stride: int = 4, time: float = HORIZON_TIME) -> Windows:
    """Return windows of one second (or the longest the data have) wherever the body moves."""
    horizon = max(1, round(time / dataset.system.dt))
    longest = max(len(episode) for episode in dataset.episodes) - history
    horizon = min(horizon, longest)
    if horizon < 1:
        raise InvalidData(f"data set: no episode is longer than {history} steps, the history asked for")
    windows = dataset.windows(horizon, stride=stride, history=history, moving=True)
    return windows if len(windows) else dataset.windows(horizon, stride=1, history=history)


def simulation_error(model: DynamicsModel, windows: Windows) -> float:
    """Return the mean over channels and steps of RMSE / standard deviation of the truth, in free run.

    Steps count alike, so that neither the first nor the last of the second alone decides.
    """
    return relative_error(model.simulate(windows.past_states, windows.past_controls, windows.controls), windows)


def relative_error(simulated: Array, windows: Windows) -> float:
    """Return the mean over channels and steps of RMSE / standard deviation; inf if not finite."""
    spread = windows.states.std(axis=(0, 1))
    spread = np.where(spread > 0, spread, 1.0)
    with np.errstate(all="ignore"):
        error = float(np.mean(np.sqrt(np.mean((simulated - windows.states) ** 2, axis=0)) / spread))
    return error if np.isfinite(error) else float("inf")


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
