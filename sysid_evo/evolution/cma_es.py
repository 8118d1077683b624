"""Covariance matrix adaptation, from a wide start."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from sysid_evo.arrays import Array, check_shape
from sysid_evo.errors import InvalidArgument
from sysid_evo.evolution.strategy import EvolutionStrategy, StrategyState
from sysid_evo.registry import register_strategy

ELITE = 15
"""Candidates of the last generation that stand for the champion, beside the mean."""
LEAST_DIMENSION = 2
"""The library does not search a line: one parameter gets a second one that counts for nothing."""
NEVER = {"tolfun": 0, "tolx": 0, "tolfunhist": 0, "tolstagnation": 10**9, "tolflatfitness": 10**9}


@register_strategy("cma_es")
class CmaEs(EvolutionStrategy):
    """CMA-ES of the library ``cma`` (Hansen, "The CMA evolution strategy: a tutorial", 2016).

    A generation is ``population`` candidates drawn from the normal distribution that it adapts, and the mean of
    that distribution, from which it learns nothing: where the fitness is noisy, the mean is often the best.
    ``sigma`` is the deviation at the start, around ``initial`` (default 0). The default is wide: units of a
    network saturate there, which is where racing controllers were found. Random numbers come from a generator
    keyed by (seed, generation).
    """

    def __init__(
        self,
        *,
        n_parameters: int,
        seed: int,
        population: int = 50,
        sigma: float = 3.0,
        initial: Array | None = None,
    ) -> None:
        if n_parameters < 1 or population < 4 or not 0.0 < sigma < np.inf:
            raise InvalidArgument(
                f"cma_es: expected n_parameters >= 1, population >= 4, sigma > 0, "
                f"got {n_parameters}, {population}, {sigma}"
            )
        self.n_parameters, self.seed = n_parameters, seed
        self.population, self.sigma = population, sigma
        centre = np.zeros(n_parameters) if initial is None else check_shape("initial", initial, (n_parameters,))
        self._centre = np.concatenate([centre, np.zeros(max(0, LEAST_DIMENSION - n_parameters))])
        self._search = self._begin()
        self._elite = centre[None].copy()
        self.generation = 0

    @property
    def elite(self) -> Array:
        return self._elite

    @property
    def state(self) -> StrategyState:
        search = self._search
        arrays = {"mean": search.mean, "covariance": search.sm.C, "axes": search.sm.B, "lengths": search.sm.D}
        paths = {"path": search.pc, "sigma_path": search.adapt_sigma.ps}
        found = {name: np.array(array, dtype=np.float64) for name, array in (arrays | paths).items()}
        return {
            "generation": self.generation,
            "sigma": float(search.sigma),
            "eigen_at": float(search.sm.last_update),
            "evaluations": int(search.countevals),
            "elite": self._elite.copy(),
            **found,
        }

    def restore(self, state: StrategyState) -> None:
        n = len(self._centre)
        shapes: dict[str, tuple[int, ...]] = dict.fromkeys(("mean", "lengths", "path", "sigma_path"), (n,))
        shapes |= {"covariance": (n, n), "axes": (n, n)}
        expected = {*shapes, "generation", "sigma", "eigen_at", "evaluations", "elite"}
        if set(state) != expected:
            raise InvalidArgument(
                f"cma_es: expected a state with {', '.join(sorted(expected))}, "
                f"got {', '.join(sorted(state)) or 'nothing'}"
            )
        found = {name: check_shape(f"state: {name}", state[name], shape).copy() for name, shape in shapes.items()}
        elite = check_shape("state: elite", state["elite"], (None, self.n_parameters)).copy()
        search = self._begin()
        if state["generation"]:  # its first cycle sets up what later ones need
            search.tell(search.ask_geno(), list(range(self.population)), check_points=False)
        search.mean, search.sigma, search.pc = found["mean"], float(state["sigma"]), found["path"]
        search.sm.C, search.sm.B, search.sm.D = found["covariance"], found["axes"], found["lengths"]
        search.adapt_sigma.ps = found["sigma_path"]
        self.generation = search.countiter = int(state["generation"])
        search.sm.count_tell = self.generation
        search.sm.last_update, search.countevals = float(state["eigen_at"]), int(state["evaluations"])
        self._search, self._elite = search, elite

    def ask(self) -> Array:
        self._asked = np.array(self._search.ask_geno())
        return np.concatenate([self._asked, self._search.mean[None]])[:, : self.n_parameters]

    def _update(self, population: Array, fitness: Array, behaviour: Array) -> None:
        if len(population) != self.population + 1:
            raise InvalidArgument(f"cma_es: expected {self.population + 1} candidates, got {len(population)}")
        best = np.argsort(-fitness, kind="stable")
        mean = len(population) - 1
        kept = best[:ELITE] if mean in best[:ELITE] else [*best[:ELITE], mean]
        self._elite = population[kept].copy()
        self._search.learn(self._asked, -fitness[:-1])
        self.generation += 1

    def _begin(self) -> Any:
        from cma.evolution_strategy import get_CMASolutionDict
        from cma.utilities.utils import ElapsedWCTime

        from sysid_evo.evolution.cma_search import CmaSearch
        from sysid_evo.evolution.gaussian_sampler import LAZIER, GaussianSampler

        def randn(*shape: int) -> Array:
            return np.random.default_rng(
                np.random.SeedSequence(self.seed, spawn_key=(self.generation,))
            ).standard_normal(shape)

        self.generation = 0
        options = {"popsize": self.population, "verbose": -9, "randn": randn, "seed": np.nan, **NEVER}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            search = CmaSearch(self._centre, self.sigma, options)
        search.sm = GaussianSampler(len(self._centre), lazy_update_gap=LAZIER * search.sm.lazy_update_gap, randn=randn)
        search.sent_solutions = get_CMASolutionDict(False)()  # none is clipped or looked up
        search.timer = ElapsedWCTime()  # `tell` stops it, and only `ask` would start it
        return search
