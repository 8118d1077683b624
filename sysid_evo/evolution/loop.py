"""The generation loop, as a generator that the caller drives, and the convergence of a search."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from sysid_evo.evolution.strategies.strategy import EvolutionStrategy, StrategyState
from sysid_evo.processors import one_blas_thread
from sysid_evo.types import Array, check_shape


@dataclass(frozen=True)
class Scores:
    """Scores of P candidates: ``fitness`` (P,), ``behaviour`` descriptors (P, d), fitness ``by_model`` (M, P).

    ``by_trial`` (P, E) is the median over the models of the fitness in each trial.
    """

    fitness: Array
    behaviour: Array | None = None
    by_model: Array | None = None
    by_trial: Array | None = None


Objective: TypeAlias = Callable[[Array, int], Scores | Array]
"""Returns the scores of candidates (P, n) in a generation, or only their fitness (P,), which is maximised."""


@dataclass(frozen=True)
class Generation:
    """One cycle of `ask` and `tell`: its number, candidates (P, n), fitness (P,), fitness on each model (M, P)."""

    index: int
    population: Array
    fitness: Array
    by_model: Array | None = None

    @property
    def summary(self) -> tuple[float, float, float]:
        """Best, mean and worst fitness of the candidates."""
        return float(self.fitness.max()), float(self.fitness.mean()), float(self.fitness.min())


def evolve(
    strategy: EvolutionStrategy, objective: Objective, generations: int, *, start: int = 0
) -> Iterator[Generation]:
    """Run cycles of `ask` and `tell` up to a total of ``generations``, and yield each one.

    A restored strategy continues with generation ``start``, the number of generations that it has completed.
    """
    for index in range(start, generations):
        with one_blas_thread():
            population = strategy.ask()
            scored = objective(population, index)
            scores = scored if isinstance(scored, Scores) else Scores(np.asarray(scored, dtype=np.float64))
            strategy.tell(population, scores.fitness, scores.behaviour)
        yield Generation(index, population, scores.fitness, scores.by_model)


EQUAL_SHARE, EQUAL_GENERATIONS, SAME = 0.5, 20, 1e-4
"""A search has converged if this share of the candidates had nearly the highest fitness in this number of generations:
at most a share `SAME` less."""


class Convergence:
    """Whether a search has converged: its caller passes every generation to `tell`.

    When many candidates have nearly the highest fitness for several generations, selection no longer distinguishes
    candidates. A search has not converged while all candidates so far are equal: it may begin where nothing is gained.
    """

    def __init__(self) -> None:
        self._lowest, self._highest = np.inf, -np.inf
        self._saturated = 0

    def tell(self, generation: Generation) -> None:
        """Register a generation."""
        self._lowest = min(self._lowest, float(generation.fitness.min()))
        self._highest = max(self._highest, float(generation.fitness.max()))
        nearly = self._highest - SAME * abs(self._highest)
        equal = self._lowest < nearly and np.mean(generation.fitness >= nearly) >= EQUAL_SHARE
        self._saturated = self._saturated + 1 if equal else 0

    @property
    def reached(self) -> bool:
        """True if half of the candidates had nearly the highest fitness in each of the last 20 generations."""
        return self._saturated >= EQUAL_GENERATIONS

    @property
    def state(self) -> StrategyState:
        """The state that `tell` changes."""
        return {"range": np.array([self._lowest, self._highest]), "saturated": self._saturated}

    def restore(self, state: StrategyState) -> None:
        """Continue from this ``state``. Raises `KeyError`, `ShapeError` or `ValueError`."""
        self._lowest, self._highest = check_shape("range", state["range"], (2,)).tolist()
        self._saturated = int(state["saturated"])
