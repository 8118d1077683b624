"""The generation loop, as a generator that belongs to the caller."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.evolution.strategy import EvolutionStrategy


@dataclass(frozen=True)
class Scores:
    """What P candidates scored: their fitness (P,), and what is known beside it.

    ``behaviour`` (P, d) holds descriptors, ``by_model`` (M, P) the fitness on each of several models.
    """

    fitness: Array
    behaviour: Array | None = None
    by_model: Array | None = None


Objective: TypeAlias = Callable[[Array, int], Scores | Array]
"""What candidates (P, n) score in a generation, or their fitness (P,) alone; maximised."""


@dataclass(frozen=True)
class Generation:
    """One ask-tell cycle: its number, candidates (P, n), their fitness (P,), and on each model (M, P)."""

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
    """Run ask-tell cycles up to ``generations`` in all, and yield each one.

    A strategy that was restored goes on from the generation ``start``, the number of those it has behind it.
    """
    for index in range(start, generations):
        population = strategy.ask()
        scored = objective(population, index)
        scores = scored if isinstance(scored, Scores) else Scores(np.asarray(scored, dtype=np.float64))
        strategy.tell(population, scores.fitness, scores.behaviour)
        yield Generation(index, population, scores.fitness, scores.by_model)
