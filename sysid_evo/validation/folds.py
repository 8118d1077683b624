"""Held-out data: recordings, conditions, blocks of time.

Model errors of neighbouring samples are correlated, and parts of a recording share battery, tyres and floor. Therefore
whole blocks of time are held out or, better, whole recordings.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from sysid_evo.data.dataset import Dataset, as_dataset
from sysid_evo.data.trajectory import Trajectory, recording
from sysid_evo.errors import InvalidArgument, InvalidData
from sysid_evo.types import BoolArray, IntArray

BLOCKS, SHORTEST = 6, 30
"""Number of blocks of time of an episode, and the least number of steps of a block."""

FOLDS = 3
"""One of this many blocks is held out."""

LEAST_SHARE = 0.5
"""Least number of training steps, as a share of those that would remain if all recordings had the same length."""

MAX_GROUPS = 4
"""Largest number of groups of recordings that are held out in turn."""

HELD_OUT_BLOCKS = 3
"""Number of blocks of time of one recording that are held out in turn, see `blocks_of`."""


def time_fold(dataset: Dataset, fold: int = 0, folds: int = FOLDS) -> tuple[Dataset, Dataset]:
    """Return training and held-out data; every ``folds``-th block of time of each episode is held out.

    An episode has 6 blocks, fewer if they were shorter than 30 steps; an episode that is too short is training data. If
    nothing can be held out, both are the whole data set.
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


def make_folds(dataset: Dataset, count: int) -> list[tuple[Dataset, Dataset]]:
    """Return up to ``count`` pairs of training and held-out data.

    Whole recordings, including all their parts, are held out; if there are more than ``count``, in groups of about the
    same length. For a single recording, or if one is so long that too little would remain, blocks of time are held out.
    """
    names = [recording(name) for name in dataset.names]
    if len(set(names)) >= 2:
        groups = balanced(names, [len(episode) for episode in dataset], min(max(count, 2), len(set(names))))
        rows = [np.isin(names, list(group)) for group in groups]
        pairs = [(dataset[np.flatnonzero(~held).tolist()], dataset[np.flatnonzero(held).tolist()]) for held in rows]
        if all(seen.n_steps >= LEAST_SHARE * dataset.n_steps * (1.0 - 1.0 / len(pairs)) for seen, _ in pairs):
            return pairs[:count]
    return _blocks_in_turn(dataset, count)


def balanced(names: Sequence[str], lengths: Sequence[int], count: int) -> list[list[str]]:
    """Return the recordings of these episodes in ``count`` groups of about the same length, in their order.

    Beginning with the longest, each is added to the group that is shortest so far, so that consecutive recordings, such
    as manoeuvres of one kind, are in different groups.
    """
    length = dict.fromkeys(names, 0)
    for name, steps in zip(names, lengths, strict=True):
        length[name] += steps
    groups: list[list[str]] = [[] for _ in range(count)]
    for name in sorted(length, key=lambda one: -length[one]):
        min(groups, key=lambda group: sum(length[one] for one in group)).append(name)
    return sorted(groups, key=lambda group: min(names.index(one) for one in group))


def recording_folds(dataset: Dataset) -> list[tuple[Dataset, Dataset]]:
    """Return training and held-out data for up to 4 groups of recordings in turn; empty for a single recording."""
    recordings = len({recording(name) for name in dataset.names})
    if recordings < 2:
        return []
    folds = EpisodeFold(min(MAX_GROUPS, recordings)).split(dataset)
    return [(dataset[list(seen)], dataset[list(held)]) for seen, held in folds]


def recording_or_time_folds(dataset: Dataset) -> list[tuple[Dataset, Dataset]]:
    """Return `recording_folds`, or for a single recording folds of blocks of time."""
    return recording_folds(dataset) or _blocks_in_turn(dataset, FOLDS)


def _blocks_in_turn(dataset: Dataset, count: int) -> list[tuple[Dataset, Dataset]]:
    """Return up to ``count`` pairs of `time_fold`; one pair of the whole data set if no block can be held out."""
    pairs = [time_fold(dataset, fold, max(count, 2)) for fold in range(count)]
    return [pair for pair in pairs if pair[0] is not pair[1]] or pairs[:1]


@dataclass(frozen=True)
class EpisodeFold:
    """Holds out whole recordings in turn, in ``n_splits`` groups; also for scikit-learn's searches::

        search = GridSearchCV(make_model("linear"), {"ridge": [0.0, 0.1]}, cv=EpisodeFold(3))
        search.fit(dataset)

    For scikit-learn a `Dataset` is a sequence of episodes: ``dataset[i]`` is the data set of episode i, and `fit` and
    `score` of a model accept a list of them.

    Parts of one recording, such as ``log[0:400]`` and ``log[400:800]``, are in the same group, because they share
    battery, tyres and floor.
    """

    n_splits: int = 5

    def __post_init__(self) -> None:
        if self.n_splits < 2:
            raise InvalidArgument(f"EpisodeFold: expected n_splits >= 2, got {self.n_splits}")

    def get_n_splits(self, X: object = None, y: object = None, groups: object = None) -> int:
        """Return the number of groups (interface of scikit-learn)."""
        return self.n_splits

    def split(
        self, X: Dataset | Sequence[Dataset], y: object = None, groups: object = None
    ) -> Iterator[tuple[IntArray, IntArray]]:
        """Yield the indices of training and held-out episodes. Raises `InvalidData` if there are too few recordings."""
        recordings = [recording(name) for name in as_dataset(X, "EpisodeFold").names]
        different = list(dict.fromkeys(recordings))
        if len(different) < self.n_splits:
            raise InvalidData(
                f"EpisodeFold: expected at least {self.n_splits} recordings, got {len(different)}; "
                "use a smaller n_splits, or hold out time with Dataset.split(0.2)"
            )
        for group in np.array_split(np.array(different, dtype=object), self.n_splits):
            held = np.isin(recordings, list(group))
            yield np.flatnonzero(~held), np.flatnonzero(held)


@dataclass(frozen=True)
class ConditionFold:
    """Holds out all recordings of one condition in turn (`Dataset.label_conditions`)."""

    def get_n_splits(
        self, X: Dataset | Sequence[Dataset] | None = None, y: object = None, groups: object = None
    ) -> int:
        """Return the number of conditions (interface of scikit-learn)."""
        return 0 if X is None else len(as_dataset(X, "ConditionFold").conditions)

    def split(
        self, X: Dataset | Sequence[Dataset], y: object = None, groups: object = None
    ) -> Iterator[tuple[IntArray, IntArray]]:
        """Yield the indices of training and held-out episodes. Raises `InvalidData` for a single condition."""
        dataset = as_dataset(X, "ConditionFold")
        if len(dataset.conditions) < 2:
            raise InvalidData(
                f"ConditionFold: expected recordings of two or more conditions, got {len(dataset.conditions)}; name "
                'them with Dataset.label_conditions({"wet": "*rain*", "dry": "*sun*"})'
            )
        of_each = np.array([episode.condition for episode in dataset], dtype=object)
        for condition in dataset.conditions:
            held = of_each == condition
            yield np.flatnonzero(~held), np.flatnonzero(held)


@dataclass(frozen=True)
class Block:
    """The samples ``low`` to ``high`` of a recording, which are held out."""

    low: int
    high: int
    horizon: int

    def held(self, first: IntArray) -> BoolArray:
        """Return a mask (B,) of the windows that begin at ``first`` (B,) and lie inside."""
        return (first >= self.low) & (first + self.horizon <= self.high)

    def learned(self, first: IntArray) -> BoolArray:
        """Return a mask (B,) of the windows that lie outside; those across an edge are neither inside nor outside."""
        return (first + self.horizon <= self.low) | (first >= self.high)

    def rest(self, dataset: Dataset) -> Dataset:
        """Return ``dataset`` without these samples."""
        parts: list[Trajectory] = []
        for episode, low, high in self._edges(dataset):
            parts += [episode[a:b] for a, b in ((0, low), (high, len(episode))) if b > a]
        return dataset.with_episodes(parts)

    def part(self, dataset: Dataset) -> Dataset:
        """Return the samples of this block in ``dataset``."""
        return dataset.with_episodes([episode[low:high] for episode, low, high in self._edges(dataset) if high > low])

    def _edges(self, dataset: Dataset) -> Iterator[tuple[Trajectory, int, int]]:
        """Yield every episode with the begin and end of the block in it."""
        begin = 0
        for episode in dataset:
            low, high = (int(np.clip(edge - begin, 0, len(episode))) for edge in (self.low, self.high))
            yield episode, low, high
            begin += len(episode)


def blocks_of(first: IntArray, horizon: int) -> list[Block]:
    """Return three blocks of time, each with a third of the windows that begin at ``first`` (B,).

    Empty if one of them has no window inside, or none outside.
    """
    edges = np.quantile(first, np.linspace(0.0, 1.0, HELD_OUT_BLOCKS + 1)).astype(int)
    edges[0], edges[-1] = 0, int(first.max()) + horizon
    blocks = [Block(low, high, horizon) for low, high in pairwise(edges.tolist())]
    return blocks if all(block.held(first).any() and block.learned(first).any() for block in blocks) else []
