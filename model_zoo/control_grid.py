"""The grid of control levels, for families with one table or network per command."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sysid_evo.errors import IncompatibleSystem
from sysid_evo.system import Channel, System
from sysid_evo.types import Array, IntArray

MOST_CELLS, BYTES = 2**20, 32
"""Largest number of cells, and bytes per cell; the search for the nearest of 10,000 commands takes half a minute."""


@dataclass(frozen=True)
class ControlGrid:
    """The grid of control levels. A control belongs to the cell of its nearest levels.

    Discrete channels have their own levels; a continuous one gets ``n_levels`` equal steps between its limits.
    ``exact`` lists the continuous channels, whose value is also an input in each cell. A system without controls has
    one cell.
    """

    levels: tuple[Array, ...]
    exact: tuple[int, ...]

    @classmethod
    def of(cls, system: System, n_levels: int) -> ControlGrid:
        """Return the cells of ``system``. Raises `IncompatibleSystem`, also for more than `MOST_CELLS`."""
        cells = cls(
            tuple(_levels(channel, n_levels) for channel in system.controls),
            tuple(i for i, channel in enumerate(system.controls) if channel.levels is None),
        )
        if cells.count > MOST_CELLS:
            each = " x ".join(str(len(levels)) for levels in cells.levels)
            raise IncompatibleSystem(
                f"expected at most {MOST_CELLS:,} commands, got {each} = {cells.count:,}: finding the nearest recorded "
                f"one for each would take {BYTES * cells.count / 1e9:,.2f} GB; use fewer levels, or a family without "
                "tables for commands, such as k_neighbours"
            )
        return cells

    @property
    def count(self) -> int:
        """Number of cells."""
        return math.prod(len(levels) for levels in self.levels)

    @property
    def midpoints(self) -> tuple[Array, ...]:
        """The boundaries between the levels of each control; a boundary belongs to the lower level."""
        return tuple((levels[1:] + levels[:-1]) / 2.0 for levels in self.levels)

    def index(self, control: Array) -> IntArray:
        """Return the cell of each control, (B, nu) -> (B,)."""
        cell = np.zeros(len(control), dtype=np.int64)
        for i, between in enumerate(self.midpoints):
            cell = cell * (len(between) + 1) + np.searchsorted(between, control[:, i])
        return cell

    def fallback(self, filled: IntArray) -> IntArray:
        """Return for every cell (count,) the nearest of the ``filled`` ones (itself if it is one).

        Distances are in shares of each channel's range; of equal ones the first counts.
        """
        shape = tuple(len(levels) for levels in self.levels)
        places = [levels / (levels[-1] - levels[0]) for levels in self.levels]
        nearest, chosen = np.full(self.count, np.inf), np.full(self.count, filled[0])
        for cell in filled:  # one at a time: all at once need quadratic memory
            squares = np.zeros(1)
            for place, level in zip(places, np.unravel_index(cell, shape), strict=True):
                squares = np.add.outer(squares, (place - place[level]) ** 2).ravel()
            distance = np.sqrt(squares)
            nearer = distance < nearest
            nearest[nearer], chosen[nearer] = distance[nearer], cell
        return chosen


def _levels(channel: Channel, n_levels: int) -> Array:
    if channel.levels is not None:
        return np.asarray(channel.levels)
    if not channel.bounded:
        raise IncompatibleSystem(
            f"control {channel.name!r} is continuous and has no limits, so it has no levels: give limits"
        )
    return np.linspace(channel.low, channel.high, n_levels)
