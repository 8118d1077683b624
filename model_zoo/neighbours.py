"""Families nearest_neighbour (the acceleration of the nearest state; paper, 4.3) and k_neighbours (a local plane)."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np
from scipy.spatial import cKDTree

from model_zoo.control_grid import ControlGrid
from model_zoo.features import Features
from model_zoo.neighbours_kernel import plane_predictor
from model_zoo.scaling import ChannelScaling, deviation
from sysid_evo import Dataset, DynamicsModel, System, register_model
from sysid_evo.models.kernels import Predictor, neighbour_predictor, on_top, with_angles
from sysid_evo.models.kernels.neighbours import EXACT_INTEGERS, numbers_taken
from sysid_evo.models.learned import Declared, Numbers
from sysid_evo.models.parameters import Limit, above, at_least
from sysid_evo.models.stochastic import StochasticModel
from sysid_evo.progress import Counter, Progress
from sysid_evo.types import Array, IntArray
from sysid_evo.validation.folds import FOLDS
from sysid_evo.validation.held_out import HeldOutError, best_candidate, count_fits, lag_candidates


@register_model("nearest_neighbour")
class NearestNeighbour(DynamicsModel):
    """Lookup table: the acceleration recorded at the nearest state under the same command (paper, section 4.3).

    The distance is Euclidean in the units of the states (paper), in sine and cosine for periodic states. A continuous
    control is rounded to the nearest of ``levels`` steps of its range and is also part of the distance; a command that
    was never recorded uses the table of the nearest recorded one. Earlier samples (none in the paper) are part of the
    distance.
    """

    knowledge = "dark grey"
    fast_fit = True
    typical_fit_seconds = 0.1
    model_class = "neighbours"
    periodic = True
    limits: ClassVar[dict[str, Limit]] = {"levels": at_least(2)}

    levels: int = 3
    state_lags: int = 0
    control_lags: int = 0

    def check_system(self, system: System) -> None:
        ControlGrid.of(system, self.levels)

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        cells = ControlGrid.of(dataset.system, self.levels)
        data = dataset.transitions(state_lags=self.lags[0], control_lags=self.lags[1])
        cell = cells.index(data.control)
        order = np.argsort(cell, kind="stable")
        self.cell_ = cell[order]
        self.points_ = Features(dataset.system, self.lags)(data.carry, data.control[:, cells.exact])[order]
        self.accelerations_ = dataset.system.acceleration(data.carry[:, : dataset.system.nx], data.after)[order]
        return self

    def learned_arrays(self) -> Mapping[str, Declared]:
        cells = ControlGrid.of(self.system, self.levels)
        seen = Features(self.system, self.lags).n_carry + len(cells.exact)
        return {
            "cell_": Numbers("points", whole=True, least=0, most=cells.count - 1, rising=True),
            "points_": ("points", seen),
            "accelerations_": ("points", self.system.nx),
        }

    def acceleration(self, carry: Array, control: Array) -> Array:
        cells, tables, serving = self._tables
        query = Features(self.system, self.lags)(carry, control[:, cells.exact])
        table = serving[cells.index(control)]
        result = np.empty((len(carry), self.accelerations_.shape[1]))
        for number, (tree, rows) in tables.items():
            queried = np.flatnonzero(table == number)
            if len(queried):
                _, nearest = tree.query(query[queried])
                result[queried] = self.accelerations_[rows][nearest]
        return result

    def predictor(self) -> Predictor | None:
        """None if there are too many commands for a compiled form; the model then runs in NumPy."""
        cells, tables, serving = self._tables
        counts = [rows.stop - rows.start for _, rows in tables.values()]
        if numbers_taken(counts, self.points_.shape[1], self.system.nx) >= EXACT_INTEGERS and len(tables) > 1:
            return None
        place = {number: i for i, number in enumerate(tables)}
        predictor = neighbour_predictor(
            [(self.points_[rows], self.accelerations_[rows]) for _, rows in tables.values()],
            np.array([place[int(number)] for number in serving]),
            cells.midpoints,
            cells.exact,
            self.points_.shape[1] - len(cells.exact),
        )
        return with_angles(predictor, self.system, self.lags)

    @cached_property
    def _tables(self) -> tuple[ControlGrid, dict[int, tuple[Any, slice]], IntArray]:
        cells = ControlGrid.of(self.system, self.levels)
        filled, first, count = np.unique(self.cell_, return_index=True, return_counts=True)
        tables = {}
        for number, begin, size in zip(filled, first, count, strict=True):
            rows = slice(int(begin), int(begin + size))
            tables[int(number)] = (cKDTree(self.points_[rows], leafsize=8), rows)
        return cells, tables, cells.fallback(filled)


NEIGHBOURS = (8, 20)
"""Numbers of neighbours that are tried if none is given."""
RIDGE = 0.03
"""Ridge penalty of the plane, as a share of the sum of the weights."""


@register_model("k_neighbours")
class KNeighbours(StochasticModel):
    """Local linear regression: the change of the state on a plane through the nearest recorded steps.

    Distance is Euclidean in (carry, control) divided by standard deviations (sine and cosine of a periodic state);
    controls count ``control_weight`` times, earlier samples half. Neighbour i of ``neighbours`` has the weight (1 -
    (d_i / d_max)^2)^2, with d_max slightly above the largest distance; the plane has a ridge penalty of 0.03 of the sum
    of weights (Atkeson, Moore, Schaal 1997). Its value is clipped to the range of the neighbours' values, so the model
    never extrapolates; a state beyond the training range returns to it in one step. The change in one step is
    predicted, not the acceleration: a lateral acceleration balances forward speed times yaw rate, and neighbours of
    slightly different speed break the balance.

    ``neighbours`` and lags left at None are chosen by the simulation error over one second on held-out blocks of time.
    """

    knowledge = "dark grey"
    fast_fit = True
    model_class = "neighbours"
    periodic = True
    precision = "float64"  # the choice of neighbours depends on the last digits
    presets: ClassVar[dict[str, dict[str, Any]]] = {"quick": {"neighbours": 8, "state_lags": 0, "control_lags": 0}}
    limits: ClassVar[dict[str, Limit]] = {"neighbours": at_least(1), "control_weight": above(0)}

    neighbours: int | None = None
    control_weight: float = 1.0
    state_lags: int | None = None
    control_lags: int | None = None
    max_steps: int | None = 100_000

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        lags = lag_candidates(self.state_lags, self.control_lags, ((0, 0), (0, 3), (1, 3)))
        counts = NEIGHBOURS if self.neighbours is None else (self.neighbours,)
        settings = [(count, pair) for pair in lags for count in counts]
        counter = Counter(progress, count_fits(settings) * FOLDS + 1)
        blocks = HeldOutError.of(dataset)

        def learned(part: Dataset, count: int, pair: tuple[int, int]) -> DynamicsModel:
            own = {"neighbours": count, "state_lags": pair[0], "control_lags": pair[1]}
            return self.clone_unfitted().set_params(**own, stochastic=False).fit(part, rng=rng)

        self.neighbours_, chosen = best_candidate(
            settings,
            lambda setting: blocks.error(lambda part: learned(part, *setting), stride=8, report=counter.advance),
        )
        self.record_lags(chosen)
        data = dataset.transitions(state_lags=self.lags[0], control_lags=self.lags[1], moving=True)
        system, features = dataset.system, Features(dataset.system, self.lags)
        inputs = features(data.carry, data.control)
        scale = ChannelScaling.of(dataset).of_inputs(self.layout)[1] if features.plain else deviation(inputs)
        weight = np.full(len(scale), 0.5)
        weight[: len(system.regressor_names)] = 1.0
        weight[len(weight) - system.nu :] = self.control_weight
        self.metric_ = weight / scale
        self.points_ = inputs * self.metric_
        self.low_, self.high_ = data.state.min(axis=0), data.state.max(axis=0)
        for i in system.periods:
            self.low_[i], self.high_[i] = -np.inf, np.inf
        self.changes_ = data.after - data.state
        counter.advance()
        self.calibrate(dataset, rng, lambda: counter.advance(0))
        return self

    def learned_arrays(self) -> Mapping[str, Declared]:
        seen, nx = Features(self.system, self.lags).n_carry + self.system.nu, self.system.nx
        limits = Numbers(nx, infinite=True)
        return {
            "neighbours_": Numbers(whole=True, least=1),
            "metric_": (seen,),
            "points_": ("points", seen),
            "changes_": ("points", nx),
            "low_": limits,
            "high_": limits,
        }

    def next_state(self, carry: Array, control: Array) -> Array:
        query = Features(self.system, self.lags)(carry, control) * self.metric_
        count = min(self.neighbours_, len(self.points_))
        distance, rows = self._tree.query(query, k=np.arange(1, count + 1))
        weight = (1.0 - (distance / (1.05 * distance[:, -1:] + 1e-12)) ** 2) ** 2
        weight = weight / weight.sum(axis=1, keepdims=True)
        targets = self.changes_[rows]
        mean = np.einsum("bk,bko->bo", weight, targets)
        offset = self.points_[rows] - query[:, None]
        centre = np.einsum("bk,bki->bi", weight, offset)
        away = offset - centre[:, None]
        weighted = away * weight[:, :, None]
        gram = np.einsum("bki,bkj->bij", weighted, away) + RIDGE * np.eye(query.shape[1])
        slope = np.linalg.solve(gram, np.einsum("bki,bko->bio", weighted, targets - mean[:, None]))
        plane = mean - np.einsum("bi,bio->bo", centre, slope)
        state = carry[:, : self.system.nx]
        inside = np.clip(state, self.low_, self.high_)
        return inside + np.clip(plane, targets.min(axis=1), targets.max(axis=1))

    def predictor(self) -> Predictor:
        change = plane_predictor(
            self.points_,
            self.changes_,
            self.metric_,
            count=min(self.neighbours_, len(self.points_)),
            ridge=RIDGE,
            n_carry=Features(self.system, self.lags).n_carry,
        )
        inside = with_angles(change, self.system, self.lags)
        return on_top(inside, np.ones(self.system.nx, dtype=bool), low=self.low_, high=self.high_)

    @cached_property
    def _tree(self) -> Any:
        return cKDTree(self.points_, leafsize=16)
