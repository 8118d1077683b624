"""Pieces of episodes as arrays: windows to simulate, transitions to learn from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid_evo.arrays import Array, BoolArray, IntArray
from sysid_evo.data.trajectory import Trajectory


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


def cut_windows(
    episodes: Sequence[Trajectory],
    horizon: int,
    *,
    stride: int = 1,
    history: int = 0,
    first: int | None = None,
    rows: Sequence[BoolArray] | None = None,
) -> Windows:
    """Cut windows of ``horizon`` steps with ``history`` samples before them, every ``stride`` samples.

    The first window starts at sample ``first``, or at ``history`` if that is later, so that all its
    history is measured and none made up. ``rows`` are masks (T + 1,), one for each episode: a window
    whose start is false in its mask is left out.
    """
    first = history if first is None else max(first, history)
    parts: list[tuple[Array, Array, Array, Array, IntArray, IntArray]] = []
    for number, episode in enumerate(episodes):
        start = np.arange(first, len(episode) - horizon + 1, stride, dtype=np.int64)
        if rows is not None:
            start = start[rows[number][start]]
        back = start[:, None] + np.arange(-history, 1)
        ahead = start[:, None] + np.arange(horizon)
        parts.append(
            (
                episode.states[back],
                episode.controls[back[:, :-1]],
                episode.controls[ahead],
                episode.states[ahead + 1],
                np.full(len(start), number, dtype=np.int64),
                start,
            )
        )
    past_states, past_controls, controls, states, numbers, starts = (
        np.concatenate(column) for column in zip(*parts, strict=True)
    )
    return Windows(
        past_states,
        past_controls,
        controls,
        states,
        numbers,
        starts,
    )
