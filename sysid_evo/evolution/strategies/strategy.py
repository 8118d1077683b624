"""The contract of an evolution strategy: ask for a population, tell its fitness."""

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
"""How the two descriptors of a channel end, see `sysid_evo.engine.behaviour_names`."""

StrategyState: TypeAlias = CheckpointState
"""All that changes in a strategy."""


class EvolutionStrategy(ABC):
    """Searches R^n for high fitness. Fitness is **maximised**.

    Made with ``n_parameters`` and ``seed``, and parameters of its own. Random numbers are best drawn
    from a generator keyed by (seed, generation), so that no generator is part of the state. Whoever evolves
    may tell what lies ahead before the first `ask`, see `prepare`.
    """

    n_parameters: int
    behaviour_names: tuple[str, ...] = ()
    control_names: tuple[str, ...] = ()
    generations: int | None = None
    updates: int = 0
    """Of how many generations it was told, counted before it learns from them."""

    def prepare(
        self, *, behaviour_names: tuple[str, ...], control_names: tuple[str, ...], generations: int | None = None
    ) -> None:
        """Tell what lies ahead: how many generations, and what the descriptors of behaviour are called.

        Without a call there are no descriptors; see `sysid_evo.engine.behaviour_names`. ``control_names`` are
        those of the channels that a controller decides on.
        """
        self.behaviour_names, self.control_names, self.generations = behaviour_names, control_names, generations

    @abstractmethod
    def ask(self) -> Array:
        """Return the candidates to evaluate next, (population, n_parameters)."""

    @abstractmethod
    def _update(self, population: Array, fitness: Array, behaviour: Array) -> None:
        """Take in the fitness (population,) of what `ask` returned, and its behaviour (population, d)."""

    @property
    @abstractmethod
    def elite(self) -> Array:
        """The candidates from which the champion is chosen, best first, (any, n_parameters)."""

    @property
    def finals(self) -> Mapping[str, Array]:
        """Candidates (any, n_parameters) by the niche they were found in: each niche gives one finalist.

        By default there is one niche without a name, that of the `elite`.
        """
        return {"": self.elite}

    def forget_fitness(self) -> None:  # noqa: B027  # most have nothing to forget
        """Forget what candidates scored: from now on the task is another; where they are found still counts.

        Does nothing by default, which is right for a strategy that compares nobody with what it was told before.
        """

    @property
    def status(self) -> str:
        """What to say beside the fitness while it runs, in a few words: how many niches are filled, for example."""
        return ""

    @property
    @abstractmethod
    def state(self) -> StrategyState:
        """All that `tell` has changed: copies, which stay as they are.

        What `ask` changes does not matter: a state that is taken after it leads the same way.
        """

    @abstractmethod
    def restore(self, state: StrategyState) -> None:
        """Go on from a ``state`` of a strategy made with the same arguments, bit for bit as that one would have.

        Raises `InvalidArgument` or `ShapeError` if it is the state of another.
        """

    def tell(self, population: Array, fitness: Array, behaviour: Array | None = None) -> None:
        """Report the fitness (population,) of what `ask` returned; nan is an error, not a fitness.

        ``behaviour`` (population, d) holds the descriptors in ``behaviour_names``; None where there are none. A
        strategy that got none before is given none.
        """
        population = check_shape("population", population, (None, self.n_parameters))
        fitness = check_shape("fitness", fitness, (len(population),))
        if np.isnan(fitness).any():
            raise InvalidArgument(
                f"tell: expected a fitness for every candidate, got nan for candidate {int(np.isnan(fitness).argmax())}"
            )
        described = (len(population), len(self.behaviour_names))
        given = np.empty((len(population), 0)) if behaviour is None or not self.behaviour_names else behaviour
        self.updates += 1
        self._update(population, fitness, check_shape("behaviour", given, described))


def make_strategy(spec: str | Spec, /, **parameters: Any) -> EvolutionStrategy:
    """Return the strategy that ``spec`` names, made with its parameters and these; see `Registry.make`."""
    made: EvolutionStrategy = strategies.make(spec, **parameters)
    return made
