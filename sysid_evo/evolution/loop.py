"""The generation loop, as a generator that belongs to the caller."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol, TypeAlias, runtime_checkable

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.evolution.strategy import EvolutionStrategy


@dataclass(frozen=True)
class Scores:
    """What P candidates scored: their fitness (P,), and what is known beside it.

    ``behaviour`` (P, d) holds descriptors, ``by_model`` (M, P) the fitness on each of several models,
    nan on one that was not run.
    """

    fitness: Array
    behaviour: Array | None = None
    by_model: Array | None = None


@runtime_checkable
class SparingObjective(Protocol):
    """An objective that can leave out work that does not matter."""

    def __call__(self, population: Array, generation: int) -> Scores | Array:
        """Return what ``population`` (P, n) scores."""
        ...

    def leading(self, population: Array, generation: int, needed: int) -> Scores | Array:
        """Return what ``population`` scores: exactly for the ``needed`` best, for others any fitness below theirs."""
        ...


Objective: TypeAlias = Callable[[Array, int], Scores | Array] | SparingObjective
"""What candidates (P, n) score in a generation, or their fitness (P,) alone; maximised."""


@dataclass(frozen=True)
class Generation:
    """One ask-tell cycle: its number, candidates (P, n), their fitness (P,), and on each model (M, P).

    Of these only the ``needed`` best are known exactly, see `EvolutionStrategy.needed`; None for all.
    """

    index: int
    population: Array
    fitness: Array
    by_model: Array | None = None
    needed: int | None = None

    @property
    def summary(self) -> tuple[float, float, float]:
        """Best, mean and worst fitness of the candidates that the strategy needs."""
        counted = self.fitness if self.needed is None else np.sort(self.fitness)[-self.needed :]
        return float(counted.max()), float(counted.mean()), float(counted.min())


def evolve(
    strategy: EvolutionStrategy, objective: Objective, generations: int, *, start: int = 0
) -> Iterator[Generation]:
    """Run ask-tell cycles up to ``generations`` in all, and yield each one.

    A strategy that was restored goes on from the generation ``start``, the number of those it has behind it.
    An objective that can leave out work (`SparingObjective`) is told how many of the best the strategy needs.
    """
    for index in range(start, generations):
        population, needed = strategy.ask(), strategy.needed
        if needed is not None and isinstance(objective, SparingObjective):
            scored = objective.leading(population, index, needed)
        else:
            scored = objective(population, index)
        scores = scored if isinstance(scored, Scores) else Scores(np.asarray(scored, dtype=np.float64))
        strategy.tell(population, scores.fitness, scores.behaviour)
        yield Generation(index, population, scores.fitness, scores.by_model, needed)
