"""The contract of an aggregate, sentence by sentence."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.errors import ContractViolation
from sysid_evo.evolution.aggregates import Aggregate
from sysid_evo.registry import make_aggregate
from sysid_evo.testing.arrays import expect_numbers, twice
from sysid_evo.testing.verdicts import Check, CheckResult, expect, raise_broken, verdicts

MODELS, CANDIDATES, TRIALS = 3, 7, 5


def check_aggregate(name: str, **parameters: Any) -> None:
    """Raise `ContractViolation` listing every sentence that the registered aggregate ``name`` breaks."""
    raise_broken("aggregate", name, run_aggregate_checks(name, **parameters))


def run_aggregate_checks(name: str, **parameters: Any) -> Iterator[CheckResult]:
    """Yield the result of every check of the registered aggregate ``name``."""
    return verdicts(lambda: make_aggregate(name, **parameters), CHECKS)


def it_gives_one_number_for_each_candidate(aggregate: Aggregate) -> None:
    """It turns (models, candidates, trials) into one finite number for each candidate, in float64"""
    expect_numbers("its result", aggregate(_fitness()), (CANDIDATES,))


def one_model_and_one_trial_are_enough(aggregate: Aggregate) -> None:
    """One model, one candidate and one trial are enough"""
    result = aggregate(_fitness()[:1, :1, :1])
    expect(np.size(result) == 1 and np.isfinite(result).all(), f"expected one finite number, got {result}")


def it_is_pure(aggregate: Aggregate) -> None:
    """It changes neither its argument nor its own later results"""
    twice("call", aggregate, _fitness())


def candidates_are_independent(aggregate: Aggregate) -> None:
    """Every candidate is judged for itself"""
    fitness = _fitness()
    together = aggregate(fitness)
    alone = np.concatenate([aggregate(fitness[:, i : i + 1]) for i in range(CANDIDATES)])
    expect(np.allclose(together, alone, rtol=1e-12), "a candidate's result changes with the other candidates")


def order_does_not_matter(aggregate: Aggregate) -> None:
    """The order of the models and of the trials does not matter"""
    fitness = _fitness()
    expected = aggregate(fitness)
    for kind, turned in (("models", fitness[::-1]), ("trials", fitness[:, :, ::-1])):
        expect(np.allclose(aggregate(turned), expected, rtol=1e-9), f"other {kind} first gives another result")


def equal_fitness_is_the_result(aggregate: Aggregate) -> None:
    """Where a candidate scores the same everywhere, that is its fitness"""
    result = aggregate(np.full((MODELS, 1, TRIALS), 2.5))
    expect(np.allclose(result, 2.5, rtol=1e-9), f"2.5 everywhere becomes {result}")


def a_gain_everywhere_is_a_gain(aggregate: Aggregate) -> None:
    """Who gains as much on every model in every trial gains"""
    fitness = _fitness()
    before, after = aggregate(fitness), aggregate(fitness + 1.0)
    expect((after > before).all(), "one more on every model in every trial does not raise it")


def bad_luck_everywhere_counts(aggregate: Aggregate) -> None:
    """Fitness below zero, as of diverged trials, is a number like any other"""
    result = aggregate(_fitness() - 20.0)
    expect(np.isfinite(result).all(), f"expected finite numbers, got {result}")


def a_population_is_ranked_fairly(aggregate: Aggregate) -> None:
    """Who is better on every model in every trial ranks no lower in a population, and equal fitness stays what it is"""
    if type(aggregate).in_population is Aggregate.in_population:
        return
    fitness = _fitness()
    fitness[:, 1] = fitness[:, 0] + 1.0
    climbed = aggregate.in_population(fitness)
    expect_numbers("in_population", climbed, (CANDIDATES,))
    expect(climbed[1] >= climbed[0], f"the better candidate of two ranks lower: {climbed[1]} below {climbed[0]}")
    alike = aggregate.in_population(np.full((MODELS, CANDIDATES, TRIALS), 2.5))
    expect(np.allclose(alike, 2.5, rtol=1e-9), f"2.5 everywhere becomes {alike}")


def the_generation_decides_the_models(aggregate: Aggregate) -> None:
    """One model or more is run in a generation, each once, and the same ones when it is asked again"""
    for count in (1, MODELS):
        for generation in range(20):
            run = aggregate.models(count, generation).tolist()
            expect(
                len(run) > 0 and run == sorted(set(run)) and set(run) <= set(range(count)),
                f"expected some of {count} models in rising order, got {run}",
            )
            expect(run == aggregate.models(count, generation).tolist(), "asked again it chooses other models")


def what_it_says_of_one_model_holds(aggregate: Aggregate) -> None:
    """Where it says so, one model alone gives the mean over its trials, to the last bit"""
    if not aggregate.mean_of_one:
        return
    fitness = _fitness()[:1] - 5.0
    mean = fitness.mean(axis=2)[0]
    for given in (aggregate(fitness), aggregate.in_population(fitness)):
        expect(np.array_equal(given, mean), f"expected the means over the trials, {mean}, got {given}")
    expect(aggregate.models(1, 3).tolist() == [0], "the one model is not run in every generation")


def a_part_bounds_the_whole(aggregate: Aggregate) -> None:
    """at_most, from some of the models, is never below what becomes of a candidate once all are run"""
    for seed in range(20):
        fitness = _fitness(seed).round() - 5.0
        reached = np.maximum(aggregate(fitness), aggregate.in_population(fitness))
        for part in ([0], [2], [0, 1], [0, 2]):
            bound = aggregate.at_most(fitness[part], MODELS)
            expect(
                np.shape(bound) == (CANDIDATES,) and not np.isnan(bound).any(),
                f"expected {CANDIDATES} numbers, infinite where nothing is known, got {bound}",
            )
            for low in np.flatnonzero(bound < reached):
                numbers = f"it is {bound[low]}, and with all of them {reached[low]}"
                raise ContractViolation(f"from {len(part)} of {MODELS} models {numbers}")


CHECKS: tuple[Check[Aggregate], ...] = (
    it_gives_one_number_for_each_candidate,
    one_model_and_one_trial_are_enough,
    it_is_pure,
    candidates_are_independent,
    order_does_not_matter,
    equal_fitness_is_the_result,
    a_gain_everywhere_is_a_gain,
    bad_luck_everywhere_counts,
    a_population_is_ranked_fairly,
    the_generation_decides_the_models,
    what_it_says_of_one_model_holds,
    a_part_bounds_the_whole,
)


def _fitness(seed: int = 5) -> Array:
    return np.random.default_rng(seed).uniform(0.0, 10.0, (MODELS, CANDIDATES, TRIALS))
