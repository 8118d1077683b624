"""The grid of control levels, for families with one table or network for each command."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from sysid_evo.errors import IncompatibleSystem
from sysid_evo.system import Channel, System
from sysid_evo.types import Array, IntArray


@dataclass(frozen=True)
class CommandCells:
    """The grid of control levels. A control belongs to the cell of its nearest levels.

    Discrete channels bring their levels; a continuous one gets ``n_levels`` equal steps between its
    limits. ``exact`` lists the continuous channels, whose value is a further input in each cell.
    A system without controls has one cell.
    """

    levels: tuple[Array, ...]
    exact: tuple[int, ...]

    @classmethod
    def of(cls, system: System, n_levels: int) -> CommandCells:
        """Return the cells of ``system``. Raises `IncompatibleSystem`."""
        return cls(
            tuple(_levels(channel, n_levels) for channel in system.controls),
            tuple(i for i, channel in enumerate(system.controls) if channel.levels is None),
        )

    @property
    def count(self) -> int:
        """Number of cells."""
        return int(np.prod([len(levels) for levels in self.levels]))

    @property
    def midpoints(self) -> tuple[Array, ...]:
        """The boundaries between the levels of each control; a boundary belongs to the lower level."""
        return tuple((levels[1:] + levels[:-1]) / 2.0 for levels in self.levels)

    @property
    def centres(self) -> Array:
        """The levels of each cell, (count, nu)."""
        return np.array(list(product(*self.levels)), dtype=np.float64).reshape(self.count, len(self.levels))

    def index(self, control: Array) -> IntArray:
        """Return the cell of each control, (B, nu) -> (B,)."""
        cell = np.zeros(len(control), dtype=np.int64)
        for i, between in enumerate(self.midpoints):
            cell = cell * (len(between) + 1) + np.searchsorted(between, control[:, i])
        return cell

    def fallback(self, filled: IntArray) -> IntArray:
        """Return for every cell (count,) the nearest of the ``filled`` ones, itself if it is one.

        Distance is in shares of each channel's range; among equals the first counts.
        """
        span = np.array([levels[-1] - levels[0] for levels in self.levels])
        places = self.centres / span
        distance = np.linalg.norm(places[:, None] - places[filled][None], axis=2)
        return filled[np.argmin(distance, axis=1)]


def _levels(channel: Channel, n_levels: int) -> Array:
    if channel.levels is not None:
        return np.asarray(channel.levels)
    if not channel.bounded:
        raise IncompatibleSystem(
            f"control {channel.name!r} is continuous and has no limits, so it cannot be cut into levels: give limits"
        )
    return np.linspace(channel.low, channel.high, n_levels)
