"""The contract of strategies: all that are listed keep it, each broken one is caught with its sentence."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from sysid_evo.errors import ContractViolation
from sysid_evo.evolution import EvolutionStrategy, StrategyState
from sysid_evo.registry import strategies
from sysid_evo.testing import check_strategy, run_strategy_checks
from sysid_evo.testing import evolution as kit
from sysid_evo.types import Array
from tests.broken import broken, sentence


class Climber(EvolutionStrategy):
    """A sound one: a parent and its children, the best of which is the next parent."""

    def __init__(self, *, n_parameters: int, seed: int) -> None:
        self.n_parameters, self.seed = n_parameters, seed
        self.generation = 0
        self.parent = np.zeros(n_parameters)

    def ask(self) -> Array:
        rng = np.random.default_rng([self.seed, self.generation])
        return self.parent + 0.2 * rng.standard_normal((8, self.n_parameters))

    def _update(self, population: Array, fitness: Array, behaviour: Array) -> None:
        self.parent = population[int(fitness.argmax())].copy()
        self.generation += 1

    @property
    def elite(self) -> Array:
        return self.parent[None]

    @property
    def state(self) -> StrategyState:
        return {"generation": self.generation, "parent": self.parent.copy()}

    def restore(self, state: StrategyState) -> None:
        self.generation, self.parent = int(state["generation"]), np.array(state["parent"])


class SinglePrecision(Climber):
    def ask(self) -> Array:
        return super().ask().astype(np.float32)


class Seedless(Climber):
    def __init__(self, *, n_parameters: int, seed: int) -> None:
        super().__init__(n_parameters=n_parameters, seed=0)


class Minimising(Climber):
    def _update(self, population: Array, fitness: Array, behaviour: Array) -> None:
        super()._update(population, -fitness, behaviour)


class BestLast(Climber):
    @property
    def elite(self) -> Array:
        away = 0.3 * np.sign(self.parent - kit.PEAK)
        return np.stack([self.parent + away, self.parent])


class Holding(Climber):
    def _update(self, population: Array, fitness: Array, behaviour: Array) -> None:
        self.parent = population[int(fitness.argmax())]
        self.generation += 1


class Credulous(Climber):
    def tell(self, population: Array, fitness: Array, behaviour: Array | None = None) -> None:
        self._update(population, fitness, np.empty((len(population), 0)))


class Scaling(Climber):
    def _update(self, population: Array, fitness: Array, behaviour: Array) -> None:
        with np.errstate(all="ignore"):
            share = (fitness - fitness.min()) / (fitness.max() - fitness.min())
        super()._update(population, fitness, behaviour)
        self.parent = self.parent * share.max()


class Forgetful(Climber):
    @property
    def state(self) -> StrategyState:
        return {"generation": 0, "parent": self.parent.copy()}


class Drawing(Climber):
    """Counts its questions, and draws by their number."""

    asked = 0

    def ask(self) -> Array:
        self.asked += 1
        rng = np.random.default_rng([self.seed, self.asked])
        return self.parent + 0.2 * rng.standard_normal((8, self.n_parameters))

    @property
    def state(self) -> StrategyState:
        return {**super().state, "asked": self.asked}

    def restore(self, state: StrategyState) -> None:
        super().restore(state)
        self.asked = int(state["asked"])


class Aliasing(Climber):
    """Hands out its own array as the state, and learns into it."""

    def _update(self, population: Array, fitness: Array, behaviour: Array) -> None:
        self.parent[:] = population[int(fitness.argmax())]
        self.generation += 1

    @property
    def state(self) -> StrategyState:
        return {"generation": self.generation, "parent": self.parent}

    @property
    def elite(self) -> Array:
        return self.parent[None].copy()


class Unstorable(Climber):
    @property
    def state(self) -> StrategyState:
        return {**super().state, "random": np.random.default_rng(0)}  # type: ignore[dict-item]  # what is tested


class Nostalgic(Climber):
    """Keeps the best it ever met, whatever the task."""

    best = -np.inf

    def _update(self, population: Array, fitness: Array, behaviour: Array) -> None:
        if fitness.max() > self.best:
            super()._update(population, fitness, behaviour)
            self.best = float(fitness.max())

    @property
    def state(self) -> StrategyState:
        return {**super().state, "best": self.best}

    def restore(self, state: StrategyState) -> None:
        super().restore(state)
        self.best = float(state["best"])


BROKEN: list[tuple[type[Climber], Callable[..., None], str]] = [
    (
        SinglePrecision,
        kit.ask_gives_candidates,
        r"ask in generation 0: expected \(8, 1\) float64, got \(8, 1\) float32",
    ),
    (Seedless, kit.the_seed_decides, "another seed asks the same candidates"),
    (Minimising, kit.fitness_is_maximised, "after 60 generations the elite is .* from the peak"),
    (BestLast, kit.the_elite_stands_best_first, "a later one of the elite is better"),
    (Holding, kit.tell_leaves_its_arguments, "what its caller does with the arrays changes it"),
    (Credulous, kit.tell_refuses_what_is_no_fitness, "expected InvalidArgument, got no error"),
    (Scaling, kit.a_plateau_is_no_end, "it asks candidates that are not finite"),
    (Forgetful, kit.a_restored_strategy_goes_on, "it goes on otherwise after 4 generations"),
    (Drawing, kit.a_restored_strategy_goes_on, "it goes on otherwise after 0 generations and a question"),
    (Aliasing, kit.a_restored_strategy_goes_on, "a state changes after it was taken"),
    (Nostalgic, kit.what_is_forgotten_does_not_count, "60 generations later, on another hill, 1 of the elite"),
    (Unstorable, kit.a_restored_strategy_goes_on, "numbers and text, 'random' is a Generator"),
]


@pytest.mark.parametrize("name", strategies.names())
def test_every_strategy_keeps_every_sentence(name: str) -> None:
    check_strategy(name)


def test_a_sound_strategy_keeps_every_sentence(register: Callable[..., Any]) -> None:
    register(strategies, "climber", Climber)
    results = list(run_strategy_checks("climber"))
    assert broken(results) == {}
    assert len(results) == 1 + len(kit.CHECKS)


@pytest.mark.parametrize(("made", "check", "reason"), BROKEN)
def test_a_broken_strategy_is_caught_with_the_one_sentence_it_breaks(
    made: type[Climber], check: Callable[..., None], reason: str, register: Callable[..., Any]
) -> None:
    register(strategies, "broken", made)
    found = broken(run_strategy_checks("broken"))
    assert list(found) == [sentence(check)]
    with pytest.raises(ContractViolation, match=f"strategy 'broken' breaks 1 of .*\n- .*{reason}"):
        check_strategy("broken")


def test_every_sentence_has_something_that_breaks_it() -> None:
    assert {check for _, check, _ in BROKEN} == set(kit.CHECKS)
