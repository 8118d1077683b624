"""The contract of an evolution strategy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from sysid_evo.errors import ContractViolation, InvalidArgument, ShapeError
from sysid_evo.evolution.loop import evolve
from sysid_evo.evolution.strategies.strategy import EvolutionStrategy, StrategyState, make_strategy
from sysid_evo.registry.grammar import Spec
from sysid_evo.registry.registry import strategies
from sysid_evo.testing.contract import Contract, copied, expect, expect_error, expect_numbers, same
from sysid_evo.types import Array

N_PARAMETERS = 4
GENERATIONS = 60
PEAK = 1.5
"""Optimum of the fitness of the checks, in every parameter."""


@dataclass(frozen=True)
class StrategyExample:
    """A spec that makes strategies of several sizes and seeds."""

    spec: Spec

    def make(self, *, seed: int = 1, n_parameters: int = N_PARAMETERS) -> EvolutionStrategy:
        """Return a new strategy."""
        return make_strategy(self.spec, n_parameters=n_parameters, seed=seed)


def check_strategy(name: str, **parameters: Any) -> None:
    """Raise `ContractViolation` with all rules that the registered strategy ``name`` breaks."""
    STRATEGY.check(name, **parameters)


def _strategy(name: str, **parameters: Any) -> tuple[StrategyExample]:
    example = StrategyExample(strategies.check(name, **parameters))
    example.make()
    return (example,)


def ask_gives_candidates(example: StrategyExample) -> None:
    """ask returns finite candidates (population, n_parameters) in float64, also for one parameter"""
    for n in (1, N_PARAMETERS):
        strategy = example.make(n_parameters=n)
        for generation in range(3):
            population = strategy.ask()
            expect(population.ndim == 2 and len(population) > 0, f"ask returns an array of shape {population.shape}")
            expect_numbers(f"ask in generation {generation}", population, (len(population), n))
            strategy.tell(population, fitness(population))


def the_seed_decides(example: StrategyExample) -> None:
    """The same seed gives the same candidates, another seed gives others"""
    first, again, other = (_candidates(example.make(seed=seed), 3) for seed in (1, 1, 2))
    expect(same(first, again), "the same seed gives other candidates")
    expect(not same(first, other), "another seed gives the same candidates")


def fitness_is_maximised(example: StrategyExample) -> None:
    """Fitness is maximised: the elite approaches the optimum of a quadratic function"""
    for seed in (1, 2):
        strategy = example.make(seed=seed)
        first = fitness(strategy.ask()).mean()
        for _ in evolve(strategy, lambda population, _: fitness(population), GENERATIONS):
            pass
        reached = float(fitness(strategy.elite)[0])
        expect(
            reached > 0.5 * first,
            f"after {GENERATIONS} generations the elite is {_distance(reached):.2f} from the optimum, "
            f"the first candidates were {_distance(float(first)):.2f} from it",
        )


def the_elite_is_ordered_best_first(example: StrategyExample) -> None:
    """The elite has at least one candidate, best first"""
    strategy = example.make()
    for _ in evolve(strategy, lambda population, _: fitness(population), 5):
        elite = strategy.elite
        expect(elite.ndim == 2 and len(elite) > 0, f"expected at least one candidate, got an array {elite.shape}")
        expect_numbers("elite", elite, (len(elite), N_PARAMETERS))
        expect((np.diff(fitness(elite)) <= 0.0).all(), "a later one of the elite is better than an earlier one")


def tell_leaves_its_arguments(example: StrategyExample) -> None:
    """A report of fitness does not change its arrays, and the strategy stores no reference to them"""
    strategy, other = example.make(), example.make()
    population = strategy.ask()
    before, score = population.copy(), fitness(population)
    strategy.tell(population, score)
    expect(same(population, before) and same(score, fitness(before)), "`tell` overwrites its arguments")
    other.tell(other.ask(), fitness(before))
    population += 7.0
    score -= 7.0
    expect(same(_candidates(strategy, 2), _candidates(other, 2)), "later changes of the arguments of `tell` affect it")


def tell_refuses_an_invalid_fitness(example: StrategyExample) -> None:
    """A report of nan, or of a fitness that is not one number for each candidate, raises an error"""
    strategy = example.make()
    population = strategy.ask()
    missing = fitness(population)
    missing[-1] = np.nan
    for wrong, error in ((missing, InvalidArgument), (fitness(population)[:-1], ShapeError)):
        expect_error(error, f"`tell` of a fitness {wrong.shape}", strategy.tell, population, wrong)


def a_plateau_does_not_stop_it(example: StrategyExample) -> None:
    """Equal fitness of all candidates, however low, does not stop it"""
    strategy = example.make()
    for generation in evolve(strategy, lambda population, _: np.full(len(population), -1e300), 5):
        expect(np.isfinite(generation.population).all(), "it returns candidates that are not finite")


def a_restored_strategy_continues(example: StrategyExample) -> None:
    """The state can be stored, and a restored strategy continues bit for bit"""
    for before in (0, 4):
        strategy = example.make()
        _candidates(strategy, before)
        state = strategy.state
        stored = _stored(state)
        expected = _candidates(strategy, 4), strategy.elite
        expect(same(list(stored.items()), list(_stored(state).items())), "a state changes after it was taken")
        for after_ask, saved in ((False, stored), (True, _stored(_asked(example, before).state))):
            other = example.make()
            _candidates(other, 2)
            other.restore(saved)
            when = f"it continues differently after {before} generations{' and a call of ask' if after_ask else ''}"
            expect(same(expected, (_candidates(other, 4), other.elite)), when)


def forgotten_fitness_does_not_count(example: StrategyExample) -> None:
    """After forget_fitness no candidate stays in the elite because of its earlier fitness"""
    strategy = example.make()
    for _ in evolve(strategy, lambda population, _: 1e6 + fitness(population), 5):
        pass
    strategy.forget_fitness()
    before = strategy.elite.copy()
    for _ in evolve(strategy, lambda population, _: fitness(-population), GENERATIONS):
        pass
    stayed = int((strategy.elite[:, None] == before).all(axis=2).any(axis=1).sum())
    expect(
        not stayed, f"{GENERATIONS} generations after a change of the fitness, {stayed} of the elite are still there"
    )


CHECKS = (
    ask_gives_candidates,
    the_seed_decides,
    fitness_is_maximised,
    the_elite_is_ordered_best_first,
    tell_leaves_its_arguments,
    tell_refuses_an_invalid_fitness,
    a_plateau_does_not_stop_it,
    a_restored_strategy_continues,
    forgotten_fitness_does_not_count,
)
STRATEGY = Contract(strategies, _strategy, CHECKS)


def fitness(population: Array) -> Array:
    """Return minus the squared distance (P,) from the optimum."""
    return -((population - PEAK) ** 2).sum(axis=1)


def _distance(value: float) -> float:
    return float(np.sqrt(-value))


def _candidates(strategy: EvolutionStrategy, generations: int) -> list[Array]:
    loop = evolve(strategy, lambda population, _: fitness(population), generations)
    return [generation.population.copy() for generation in loop]


def _asked(example: StrategyExample, generations: int) -> EvolutionStrategy:
    """Return a strategy after ``generations`` and one further `ask` without `tell`."""
    strategy = example.make()
    _candidates(strategy, generations)
    strategy.ask()
    return strategy


def _stored(state: StrategyState) -> Mapping[str, Any]:
    """Return a copy of ``state``. Raises `ContractViolation` for a value that cannot be stored."""
    for name, value in state.items():
        if not isinstance(value, (int, float, str)) and not (
            isinstance(value, np.ndarray) and value.dtype == np.float64
        ):
            what = f"an array of {value.dtype}" if isinstance(value, np.ndarray) else f"a {type(value).__name__}"
            raise ContractViolation(f"state: expected float64 arrays, numbers and text, {name!r} is {what}")
    return {name: copied(value) for name, value in state.items()}
