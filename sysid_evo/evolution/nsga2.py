"""Several models as several objectives, none of them given up for another."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from sysid_evo.arrays import Array, IntArray, check_shape
from sysid_evo.errors import InvalidArgument
from sysid_evo.evolution.strategy import EvolutionStrategy, StrategyState
from sysid_evo.extras import check_installed
from sysid_evo.registry import register_strategy

LARGEST = 1e300
"""Fitness beyond this counts as this, since distances between candidates are taken."""


@register_strategy("nsga2")
class Nsga2(EvolutionStrategy):
    """The selection of NSGA-II (Deb et al. 2002), with the fitness on each model as an objective of its own.

    Who is beaten by nobody on all models at once survives first, and of these who stands alone; both are counted
    by the library ``pymoo``. So a controller that is good on one model and fails on another stays in the search,
    which a minimum over the models would drop. Parents are the better of two drawn at random, and a child
    is one plus normal numbers of deviation ``sigma``. There are ``population`` of each, and parents are asked again
    in every generation. The first are ``initial`` (default 0) plus normal numbers of deviation ``spread``. The
    elite is by the fitness over all models. On one model, or inside of another strategy that does not tell models
    apart, the fitness is the only objective. Beyond four models hardly anybody is beaten on all at once.
    """

    requires: ClassVar[tuple[str, ...]] = ("pymoo",)

    def __init__(
        self,
        *,
        n_parameters: int,
        seed: int,
        population: int = 50,
        sigma: float = 0.1,
        spread: float = 0.5,
        initial: Array | None = None,
    ) -> None:
        if n_parameters < 1 or population < 2 or sigma <= 0 or spread < 0:
            raise InvalidArgument(
                "nsga2: expected n_parameters >= 1, population >= 2, sigma > 0, spread >= 0, "
                f"got {n_parameters}, {population}, {sigma}, {spread}"
            )
        check_installed("strategy 'nsga2'", self.requires)
        self.n_parameters, self.seed = n_parameters, seed
        self.population, self.sigma = population, sigma
        self.generation = 0
        centre = np.zeros(n_parameters) if initial is None else check_shape("initial", initial, (n_parameters,))
        self._parents = centre + spread * self._rng().standard_normal((population, n_parameters))
        self._fitness = np.full(population, -np.inf)

    @property
    def elite(self) -> Array:
        return self._parents[np.argsort(-self._fitness, kind="stable")]

    @property
    def state(self) -> StrategyState:
        return {"generation": self.generation, "parents": self._parents.copy(), "fitness": self._fitness.copy()}

    def restore(self, state: StrategyState) -> None:
        if set(state) != {"generation", "parents", "fitness"}:
            raise InvalidArgument(f"nsga2: expected a state with generation, parents and fitness, got {sorted(state)}")
        self._parents = check_shape("state: parents", state["parents"], (self.population, self.n_parameters)).copy()
        self._fitness = check_shape("state: fitness", state["fitness"], (self.population,)).copy()
        self.generation = int(state["generation"])

    def ask(self) -> Array:
        if self.generation == 0:
            return self._parents
        rng = self._rng()
        better = rng.integers(self.population, size=(2, self.population)).min(axis=0)  # parents stand best first
        children = self._parents[better] + self.sigma * rng.standard_normal(self._parents.shape)
        return np.concatenate([self._parents, children])

    def _update(self, population: Array, fitness: Array, behaviour: Array) -> None:
        objectives = fitness[None] if self.by_model is None else self.by_model
        run = objectives[~np.isnan(objectives).any(axis=1)]
        kept = best_first(run if len(run) else fitness[None])[: self.population]
        self._parents, self._fitness = population[kept], fitness[kept]
        self.generation += 1

    def _rng(self) -> np.random.Generator:
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(self.generation,)))


def best_first(objectives: Array) -> IntArray:
    """Return the order of candidates by their ``objectives`` (M, P): by rank, within a rank the lonely first.

    The rank of a candidate is that of its front: the first are those than whom nobody is at least as good in
    every objective and better in one; the next those that are first once these are gone.
    """
    from pymoo.operators.survival.rank_and_crowding.metrics import calc_crowding_distance
    from pymoo.util.nds.non_dominated_sorting import NonDominatedSorting

    costs = -np.clip(objectives.T, -LARGEST, LARGEST)
    fronts = [np.asarray(front, dtype=np.int64) for front in NonDominatedSorting().do(costs)]
    return np.concatenate([front[np.argsort(-calc_crowding_distance(costs[front]), kind="stable")] for front in fronts])
