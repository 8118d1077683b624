"""Where recordings end: the distance of a state and control to the nearest recorded ones."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from sysid_evo.data.trajectory import Trajectory, evenly_spaced
from sysid_evo.errors import InvalidData
from sysid_evo.system import System
from sysid_evo.types import Array, BoolArray, check_shape

QUANTILE = 0.99
KEPT_PAIRS = 2048
"""Pairs of state and control that a fitted model keeps of its training data, evenly spread over them."""


@dataclass(frozen=True)
class Support:
    """Recorded states and controls (N, n), and the distance ``limit`` beyond which others are outside them.

    Distances are Euclidean, every channel divided by ``scale`` (n,): its standard deviation in the recording
    (a channel that is constant there counts in its own unit). Sine and cosine stand for a periodic state.
    ``limit`` is the 99 % quantile of the distance from each recorded pair to its nearest other one, so that
    about 1 % of the recording itself is outside.
    """

    system: System
    points: Array
    scale: Array
    limit: float

    @classmethod
    def of(cls, system: System, states: Array, controls: Array, *, moving: BoolArray | None = None) -> Support:
        """Build from states (N, nx) and controls (N, nu); ``moving`` (N,) says which rows set scale and limit.

        By default all do that differ from every other one. Raises `InvalidData` with fewer than two.
        """
        from scipy.spatial import cKDTree

        pairs = regressors(system, states, controls)
        if len(pairs) < 2:
            raise InvalidData(f"support: expected two or more training pairs, got {len(pairs)}")
        chosen = pairs if moving is None else pairs[moving]
        std = chosen.std(axis=0)
        scale = np.where(std > 0, std, 1.0)
        distances = np.asarray(cKDTree(pairs / scale).query(chosen / scale, k=2)[0])[:, 1]
        if moving is None and (distances > 0.0).any():
            distances = distances[distances > 0.0]
        return cls(system, pairs / scale, scale, float(np.quantile(distances, QUANTILE)))

    def distances(self, states: Array, controls: Array) -> Array:
        """Return the distance (B,) of each pair to the nearest recorded one, in standard deviations."""
        found, _ = self._tree.query(regressors(self.system, states, controls) / self.scale)
        return np.asarray(found, dtype=np.float64)

    @cached_property
    def _tree(self) -> Any:
        from scipy.spatial import cKDTree

        return cKDTree(self.points)


def regressors(system: System, states: Array, controls: Array) -> Array:
    """Return states and controls side by side, (N, n); sine and cosine stand for a periodic state."""
    return np.concatenate([system.regressors(states), controls], axis=1)


def recorded_pairs(episodes: Iterable[Trajectory], most: int = KEPT_PAIRS) -> Array:
    """Return states and controls of ``episodes`` side by side, (N, nx + nu), at most ``most``, evenly spread."""
    pairs = np.concatenate([np.concatenate([episode.states[:-1], episode.controls], axis=1) for episode in episodes])
    return pairs[evenly_spaced(len(pairs), most, nearest=True)]


def split_pairs(system: System, pairs: Array) -> tuple[Array, Array]:
    """Return the states (N, nx) and the controls (N, nu) of `recorded_pairs`."""
    pairs = check_shape("pairs", pairs, (None, system.nx + system.nu))
    return pairs[:, : system.nx], pairs[:, system.nx :]
