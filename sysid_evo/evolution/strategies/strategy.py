"""The contract of an evolution strategy: `ask` for a population, `tell` its fitness."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np

from sysid_evo.errors import InvalidArgument
from sysid_evo.progress import CheckpointState
from sysid_evo.registry.grammar import Spec
from sysid_evo.registry.registry import strategies
from sysid_evo.types import Array, check_shape

ABOVE, BELOW = "above", "below"
"""Last words of the two descriptors of a channel, see `sysid_evo.engine.behaviour_names`."""

StrategyState: TypeAlias = CheckpointState
"""The variables of a strategy that `tell` changes."""


class EvolutionStrategy(ABC):
    """Search of R^n for high fitness. Fitness is **maximised**.

    The constructor takes ``n_parameters``, ``seed`` and the parameters of the strategy. Draw random numbers from a
    generator keyed by (seed, generation): then no generator is part of the state. The caller may call `prepare` before
    the first `ask`.
    """

    n_parameters: int
    behaviour_names: tuple[str, ...] = ()
    control_names: tuple[str, ...] = ()
    generations: int | None = None
    updates: int = 0
    """Number of calls of `tell`, counted before the update."""

    def prepare(
        self, *, behaviour_names: tuple[str, ...], control_names: tuple[str, ...], generations: int | None = None
    ) -> None:
        """Set the number of generations and the names of the behaviour descriptors.

        Without this call there are no descriptors; see `sysid_evo.engine.behaviour_names`. ``control_names`` are the
        channels that a controller sets.
        """
        self.behaviour_names, self.control_names, self.generations = behaviour_names, control_names, generations

    @abstractmethod
    def ask(self) -> Array:
        """Return the candidates to evaluate next, (population, n_parameters)."""

    @abstractmethod
    def _update(self, population: Array, fitness: Array, behaviour: Array) -> None:
        """Learn from the fitness (population,) and behaviour (population, d) of the candidates of `ask`."""

    @property
    @abstractmethod
    def elite(self) -> Array:
        """The candidates among which the champion is chosen, best first, (any, n_parameters)."""

    @property
    def finals(self) -> Mapping[str, Array]:
        """Candidates (any, n_parameters) by behaviour class, each giving one finalist; by default the `elite`."""
        return {"": self.elite}

    def forget_fitness(self) -> None:  # noqa: B027  # most strategies store no fitness
        """Discard stored fitness, because the task changes; the distribution of the candidates remains.

        Does nothing by default, which is right for a strategy that compares candidates of one generation only.
        """

    @property
    def status(self) -> str:
        """Short text for the progress display, for example the number of filled niches."""
        return ""

    @property
    @abstractmethod
    def state(self) -> StrategyState:
        """Copies of all variables that `tell` changes; a state taken after `ask` leads to the same search."""

    @abstractmethod
    def restore(self, state: StrategyState) -> None:
        """Continue, bit for bit, from the ``state`` of a strategy made with the same arguments.

        Raises `InvalidArgument` or `ShapeError` if it is the state of another strategy.
        """

    def tell(self, population: Array, fitness: Array, behaviour: Array | None = None) -> None:
        """Report the fitness (population,) of the candidates of `ask`. Raises `InvalidArgument` for nan.

        ``behaviour`` (population, d) holds the descriptors in ``behaviour_names``, None without descriptors. It is
        ignored if `prepare` set no names.
        """
        population = check_shape("population", population, (None, self.n_parameters))
        fitness = check_shape("fitness", fitness, (len(population),))
        if np.isnan(fitness).any():
            raise InvalidArgument(
                f"expected a fitness for every candidate, got nan for candidate {int(np.isnan(fitness).argmax())}"
            )
        described = (len(population), len(self.behaviour_names))
        given = np.empty((len(population), 0)) if behaviour is None or not self.behaviour_names else behaviour
        self.updates += 1
        self._update(population, fitness, check_shape("behaviour", given, described))


def make_strategy(spec: str | Spec, /, **parameters: Any) -> EvolutionStrategy:
    """Return the strategy that ``spec`` names, with its parameters and ``parameters``; see `Registry.make`."""
    made: EvolutionStrategy = strategies.make(spec, **parameters)
    return made
