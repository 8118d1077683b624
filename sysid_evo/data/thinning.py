"""A part of a very long recording that stands for all of it: whole blocks of time at random places."""

from __future__ import annotations

import numpy as np

from sysid_evo.data.dataset import Dataset

SHORTEST, LONGEST = 100, 1000
"""Steps in a row: enough that few windows are lost at their ends."""

BLOCKS = 20
"""Fewest blocks from different times, if they are not too short."""


def thinned(dataset: Dataset, most: int, rng: np.random.Generator) -> Dataset:
    """Return ``dataset`` if it has at most ``most`` steps, else so many of it or a little fewer.

    What is kept are blocks of up to 1000 consecutive steps (of a twentieth of ``most``, but 100, if that is less),
    drawn without replacement and joined where they touch, in the order of the recording. ``rng`` is used only if
    something is left out.
    """
    if dataset.n_steps <= most:
        return dataset
    block = min(LONGEST, max(SHORTEST, most // BLOCKS), most)
    owner, begin, end = [], [], []
    for number, episode in enumerate(dataset):
        edges = np.linspace(0, len(episode), -(-len(episode) // block) + 1).astype(np.int64)
        owner.append(np.full(len(edges) - 1, number))
        begin.append(edges[:-1])
        end.append(edges[1:])
    owners, begins, ends = (np.concatenate(part) for part in (owner, begin, end))
    order = rng.permutation(len(owners))
    kept = np.sort(order[np.cumsum((ends - begins)[order]) <= most])
    first = np.concatenate([[True], np.diff(kept) > 1]) | np.concatenate([[True], np.diff(owners[kept]) > 0])
    runs = np.split(kept, np.flatnonzero(first)[1:])
    pieces = [dataset.episodes[owners[run[0]]][int(begins[run[0]]) : int(ends[run[-1]])] for run in runs]
    return dataset.with_episodes(pieces)
