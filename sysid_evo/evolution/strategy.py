"""The contract of an evolution strategy: ask for a population, tell its fitness."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from sysid_evo.arrays import Array, check_shape
from sysid_evo.errors import InvalidArgument


class EvolutionStrategy(ABC):
    """Searches R^n for high fitness. Fitness is **maximised**."""

    n_parameters: int

    @abstractmethod
    def ask(self) -> Array:
        """Return the candidates to evaluate next, (population, n_parameters)."""

    @abstractmethod
    def _update(self, population: Array, fitness: Array) -> None:
        """Take in the fitness (population,) of what `ask` returned."""

    @property
    @abstractmethod
    def elite(self) -> Array:
        """The candidates from which the champion is chosen, best first, (any, n_parameters)."""

    def tell(self, population: Array, fitness: Array) -> None:
        """Report the fitness (population,) of what `ask` returned; nan is an error, not a fitness."""
        population = check_shape("population", population, (None, self.n_parameters))
        fitness = check_shape("fitness", fitness, (len(population),))
        if np.isnan(fitness).any():
            raise InvalidArgument(
                f"tell: expected a fitness for every candidate, got nan for candidate {int(np.isnan(fitness).argmax())}"
            )
        self._update(population, fitness)
