"""Extrapolation: the distance of a state and control from the nearest recorded ones."""

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
"""Number of pairs of state and control in the training sample of a fitted model, evenly spaced in the data."""


@dataclass(frozen=True)
class Support:
    """Recorded states and controls (N, n), and the distance ``limit`` beyond which others are outside the data.

    Distances are Euclidean, with every channel divided by ``scale`` (n,): its standard deviation in the recording
    (1 of its unit for a constant channel). A periodic state is replaced by sine and cosine. ``limit`` is the 99 %
    quantile of the distance between each recorded pair and its nearest neighbour, so that about 1 % of the recording
    itself is outside.
    """

    system: System
    points: Array
    scale: Array
    limit: float

    @classmethod
    def of(cls, system: System, states: Array, controls: Array, *, moving: BoolArray | None = None) -> Support:
        """Return the support of states (N, nx) and controls (N, nu); ``moving`` (N,) are the rows for scale and limit.

        By default these are all distinct rows. Raises `InvalidData` for fewer than two.
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
    """Return states and controls as columns, (N, n); a periodic state is replaced by sine and cosine."""
    return np.concatenate([system.regressors(states), controls], axis=1)


def recorded_pairs(episodes: Iterable[Trajectory], most: int = KEPT_PAIRS) -> Array:
    """Return at most ``most`` evenly spaced pairs of state and control of ``episodes``, (N, nx + nu)."""
    pairs = np.concatenate([np.concatenate([episode.states[:-1], episode.controls], axis=1) for episode in episodes])
    return pairs[evenly_spaced(len(pairs), most, nearest=True)]


def split_pairs(system: System, pairs: Array) -> tuple[Array, Array]:
    """Return the states (N, nx) and the controls (N, nu) of `recorded_pairs`."""
    pairs = check_shape("pairs", pairs, (None, system.nx + system.nu))
    return pairs[:, : system.nx], pairs[:, system.nx :]
