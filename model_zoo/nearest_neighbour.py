"""Nearest neighbour: one table of recorded states and accelerations for each command (paper, section 4.3)."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from scipy.spatial import cKDTree

from model_zoo.channels.command_cells import CommandCells
from model_zoo.channels.features import Features
from sysid_evo import Dataset, DynamicsModel, System, register_model
from sysid_evo.arrays import Array, IntArray
from sysid_evo.hyperparameters import Limit, at_least
from sysid_evo.progress import Progress

if TYPE_CHECKING:
    from sysid_evo.kernels import DynamicsKernel


@register_model("nearest_neighbour")
class NearestNeighbour(DynamicsModel):
    """The acceleration recorded in the nearest state under the same command.

    Distance is Euclidean in the states' own units (paper), in sine and cosine of periodic ones. A continuous
    control falls into the nearest of ``levels`` steps of its range and joins the state as a further input; a
    command that was never recorded uses the table of the nearest one that was. Lags (none in the paper) join the
    state in the distance.
    """

    knowledge = "dark grey"
    cheap = True
    structure = "neighbours"
    periodic = True
    limits: ClassVar[dict[str, Limit]] = {"levels": at_least(2)}

    levels: int = 3
    state_lags: int = 0
    control_lags: int = 0
    rest_hold: bool = False

    def check_system(self, system: System) -> None:
        CommandCells.of(system, self.levels)

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        cells = CommandCells.of(dataset.system, self.levels)
        data = dataset.transitions(state_lags=self.lags[0], control_lags=self.lags[1])
        cell = cells.index(data.control)
        order = np.argsort(cell, kind="stable")
        self.cell_ = cell[order]
        self.points_ = Features(dataset.system, self.lags)(data.carry, data.control[:, cells.exact])[order]
        self.accelerations_ = dataset.system.acceleration(data.carry[:, : dataset.system.nx], data.after)[order]
        return self

    def acceleration(self, carry: Array, control: Array) -> Array:
        cells, tables, serving = self._tables
        query = Features(self.system, self.lags)(carry, control[:, cells.exact])
        table = serving[cells.index(control)]
        result = np.empty((len(carry), self.accelerations_.shape[1]))
        for number, (tree, rows) in tables.items():
            asked = np.flatnonzero(table == number)
            if len(asked):
                _, nearest = tree.query(query[asked])
                result[asked] = self.accelerations_[rows][nearest]
        return result

    def kernel(self) -> DynamicsKernel | None:
        return self._compiled

    @cached_property
    def _compiled(self) -> DynamicsKernel | None:
        from sysid_evo.engine.kernels import neighbour_predictor, with_angles

        cells, tables, serving = self._tables
        place = {number: i for i, number in enumerate(tables)}
        predictor = neighbour_predictor(
            [(self.points_[rows], self.accelerations_[rows]) for _, rows in tables.values()],
            np.array([place[int(number)] for number in serving]),
            cells.midpoints,
            cells.exact,
            self.points_.shape[1] - len(cells.exact),
        )
        return self.stepping(with_angles(predictor, self.system, self.lags))

    @cached_property
    def _tables(self) -> tuple[CommandCells, dict[int, tuple[Any, slice]], IntArray]:
        cells = CommandCells.of(self.system, self.levels)
        filled, first, count = np.unique(self.cell_, return_index=True, return_counts=True)
        tables = {}
        for number, begin, size in zip(filled, first, count, strict=True):
            rows = slice(int(begin), int(begin + size))
            tables[int(number)] = (cKDTree(self.points_[rows], leafsize=8), rows)
        return cells, tables, cells.fallback(filled)
