"""Pieces of episodes as arrays: windows to simulate, transitions to learn from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid_evo.arrays import Array, BoolArray, IntArray
from sysid_evo.data.trajectory import Trajectory

INDICES = 2**16
"""Samples that are cut at a time."""


@dataclass(frozen=True)
class Windows:
    """N windows of H steps, each with L samples of history; none crosses an episode.

    ``past_states`` (N, L + 1, nx) ends at the start of the window, ``past_controls`` (N, L, nu) at
    the sample before it; ``controls`` (N, H, nu) lead to ``states`` (N, H, nx). ``episode`` and
    ``start`` (N,) say where each window begins.
    """

    past_states: Array
    past_controls: Array
    controls: Array
    states: Array
    episode: IntArray
    start: IntArray

    def __len__(self) -> int:
        return len(self.start)

    @property
    def start_states(self) -> Array:
        """The measured state at the start of each window, (N, nx)."""
        return self.past_states[:, -1]

    def __getitem__(self, rows: IntArray | slice) -> Windows:
        return Windows(
            self.past_states[rows],
            self.past_controls[rows],
            self.controls[rows],
            self.states[rows],
            self.episode[rows],
            self.start[rows],
        )


@dataclass(frozen=True)
class WindowPlaces:
    """Where N windows of ``horizon`` steps and ``history`` earlier samples lie; ``places[rows]`` cuts some of them.

    ``states`` (M + E, nx) and ``controls`` (M, nu) are those of all E episodes in a row; a window begins at sample
    ``start`` (N,) of ``episode`` (N,), which is row ``place`` (N,) of ``states``.
    """

    states: Array
    controls: Array
    episode: IntArray
    start: IntArray
    place: IntArray
    horizon: int
    history: int

    @classmethod
    def of(
        cls,
        episodes: Sequence[Trajectory],
        horizon: int,
        *,
        stride: int = 1,
        history: int = 0,
        first: int | None = None,
        rows: Sequence[BoolArray] | None = None,
    ) -> WindowPlaces:
        """Find windows of ``horizon`` steps with ``history`` samples before them, every ``stride`` samples.

        The first window starts at sample ``first``, or at ``history`` if that is later, so that all its
        history is measured and none made up. ``rows`` are masks (T + 1,), one for each episode: a window
        whose start is false in its mask is left out.
        """
        first = history if first is None else max(first, history)
        starts = []
        for number, episode in enumerate(episodes):
            start = np.arange(first, len(episode) - horizon + 1, stride, dtype=np.int64)
            starts.append(start if rows is None else start[rows[number][start]])
        counts = [len(start) for start in starts]
        begins = np.cumsum([0, *(len(episode) + 1 for episode in episodes)])[:-1]
        start = np.concatenate(starts)
        return cls(
            _joined([episode.states for episode in episodes]),
            _joined([episode.controls for episode in episodes]),
            np.repeat(np.arange(len(episodes), dtype=np.int64), counts),
            start,
            start + np.repeat(begins, counts),
            horizon,
            history,
        )

    def __len__(self) -> int:
        return len(self.start)

    @property
    def last_states(self) -> Array:
        """The state after the last step of each window, (N, nx)."""
        return self.states[self.place + self.horizon]

    def __getitem__(self, rows: IntArray | slice) -> Windows:
        """Return these windows."""
        episode, start, place = self.episode[rows], self.start[rows], self.place[rows]
        before, ahead = np.arange(-self.history, 1), np.arange(self.horizon)
        return Windows(
            _cut(self.states, place, before),
            _cut(self.controls, place - episode, before[:-1]),
            _cut(self.controls, place - episode, ahead),
            _cut(self.states, place, ahead + 1),
            episode,
            start,
        )


def _joined(arrays: Sequence[Array]) -> Array:
    return arrays[0] if len(arrays) == 1 else np.concatenate(arrays)


def _cut(samples: Array, place: IntArray, around: IntArray) -> Array:
    """Return the samples (N, H, c) ``around`` (H,) each ``place`` (N,), without index arrays of that size."""
    found = np.empty((len(place), len(around), samples.shape[1]))
    at_once = max(1, INDICES // max(1, len(around)))
    for begin in range(0, len(place), at_once):
        part = slice(begin, begin + at_once)
        np.take(samples, place[part, None] + around, axis=0, out=found[part], mode="clip")
    return found
