"""The paper's evolution strategy: 50 parents, 50 children, the best 50 survive (section 4.2)."""

from __future__ import annotations

import numpy as np

from sysid_evo.errors import InvalidArgument
from sysid_evo.evolution.strategies.strategy import EvolutionStrategy, StrategyState
from sysid_evo.randomness import keyed_generator
from sysid_evo.registry.registry import register_strategy
from sysid_evo.types import Array, check_shape


@register_strategy("mu_plus_lambda")
class MuPlusLambda(EvolutionStrategy):
    """A (parents + children) strategy with Gaussian mutation of all parameters.

    Child i is parent i modulo ``parents`` plus normal numbers of standard deviation ``sigma`` (0.1: the paper's
    "variance 0.01"), drawn from a generator keyed by (seed, generation, child). The first parents are ``initial``
    (default 0) plus normal numbers of standard deviation ``spread``. With ``reevaluate`` (the default) parents are
    evaluated again in every generation, so that a high score by chance does not persist under noisy fitness; without
    it they keep their first fitness. The paper does not specify this. Among equals the newer candidate survives, so
    that the search drifts on a plateau.
    """

    def __init__(
        self,
        *,
        n_parameters: int,
        seed: int,
        parents: int = 50,
        children: int = 50,
        sigma: float = 0.1,
        spread: float = 0.5,
        initial: Array | None = None,
        reevaluate: bool = True,
    ) -> None:
        if n_parameters < 1 or parents < 1 or children < 1 or sigma <= 0 or spread < 0:
            raise InvalidArgument(
                "mu_plus_lambda: expected n_parameters, parents, children >= 1, sigma > 0, spread >= 0, "
                f"got {n_parameters}, {parents}, {children}, {sigma}, {spread}"
            )
        self.n_parameters, self.seed = n_parameters, seed
        self.n_parents, self.n_children, self.sigma = parents, children, sigma
        self.reevaluate = reevaluate
        self.generation = 0
        centre = np.zeros(n_parameters) if initial is None else check_shape("initial", initial, (n_parameters,))
        self._parents = centre + spread * self._normal(0, parents)
        self._parents_fitness: Array | None = None

    @property
    def elite(self) -> Array:
        return self._parents

    @property
    def state(self) -> StrategyState:
        scored = {} if self._parents_fitness is None else {"parents_fitness": self._parents_fitness.copy()}
        return {"generation": self.generation, "parents": self._parents.copy(), **scored}

    def restore(self, state: StrategyState) -> None:
        unknown = set(state) - {"generation", "parents", "parents_fitness"}
        if unknown or not {"generation", "parents"} <= set(state):
            raise InvalidArgument(
                "mu_plus_lambda: expected a state with generation, parents and perhaps parents_fitness, "
                f"got {', '.join(sorted(state)) or 'nothing'}"
            )
        parents = check_shape("state: parents", state["parents"], (self.n_parents, self.n_parameters))
        fitness = state.get("parents_fitness")
        if fitness is not None:
            fitness = check_shape("state: parents_fitness", fitness, (self.n_parents,)).copy()
        self._parents, self._parents_fitness, self.generation = parents.copy(), fitness, int(state["generation"])

    def ask(self) -> Array:
        repeated = self._parents[np.arange(self.n_children) % self.n_parents]
        children = repeated + self.sigma * self._normal(self.generation + 1, self.n_children)
        if self._parents_fitness is not None and not self.reevaluate:
            return children
        return np.concatenate([self._parents, children])

    def forget_fitness(self) -> None:
        self._parents_fitness = None

    def _update(self, population: Array, fitness: Array, behaviour: Array) -> None:
        if self._parents_fitness is not None and not self.reevaluate:
            population = np.concatenate([self._parents, population])
            fitness = np.concatenate([self._parents_fitness, fitness])
        newest_first = np.arange(len(fitness))[::-1]
        order = newest_first[np.argsort(-fitness[newest_first], kind="stable")][: self.n_parents]
        self._parents, self._parents_fitness = population[order], fitness[order]
        self.generation += 1

    def _normal(self, generation: int, count: int) -> Array:
        generators = [keyed_generator(self.seed, generation, i) for i in range(count)]
        return np.stack([rng.standard_normal(self.n_parameters) for rng in generators])
