"""The generation loop, as a generator that belongs to the caller."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.evolution.strategy import EvolutionStrategy

Objective: TypeAlias = Callable[[Array, int], Array]
"""Fitness (P,) of candidates (P, n) in a generation; maximised."""


@dataclass(frozen=True)
class Generation:
    """One ask-tell cycle: its number, candidates (P, n) and their fitness (P,)."""

    index: int
    population: Array
    fitness: Array

    @property
    def summary(self) -> tuple[float, float, float]:
        """Best, mean and worst fitness."""
        return float(self.fitness.max()), float(self.fitness.mean()), float(self.fitness.min())


def evolve(strategy: EvolutionStrategy, objective: Objective, generations: int) -> Iterator[Generation]:
    """Run ``generations`` ask-tell cycles and yield each one."""
    for index in range(generations):
        population = strategy.ask()
        fitness = np.asarray(objective(population, index), dtype=np.float64)
        strategy.tell(population, fitness)
        yield Generation(index, population, fitness)
