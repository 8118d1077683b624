"""The contract of aggregates: all that are listed keep it, each broken one is caught with its sentence."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from sysid_evo.arrays import Array, IntArray
from sysid_evo.errors import ContractViolation, UnknownName
from sysid_evo.evolution import Aggregate
from sysid_evo.registry import aggregates
from sysid_evo.testing import aggregates as kit
from sysid_evo.testing import check_aggregate, run_aggregate_checks
from tests.broken import broken, sentence


class Cautious(Aggregate):
    """A sound one: it takes the spread over the trials off."""

    def __call__(self, fitness: Array) -> Array:
        return (fitness.mean(axis=2) - fitness.std(axis=2)).min(axis=0)


class SinglePrecision(Aggregate):
    def __call__(self, fitness: Array) -> Array:
        return fitness.mean(axis=(0, 2)).astype(np.float32)


class SpreadOfMany(Aggregate):
    def __call__(self, fitness: Array) -> Array:
        with np.errstate(all="ignore"):
            spread = ((fitness - fitness.mean(axis=2, keepdims=True)) ** 2).sum(axis=2) / (fitness.shape[2] - 1)
        return (fitness.mean(axis=2) - spread).min(axis=0)


class Sorting(Aggregate):
    def __call__(self, fitness: Array) -> Array:
        fitness.sort(axis=2)
        return fitness.mean(axis=(0, 2))


class Comparing(Aggregate):
    def __call__(self, fitness: Array) -> Array:
        mean = fitness.mean(axis=(0, 2))
        return mean + 0.01 * (mean - mean.mean())


class FirstModel(Aggregate):
    def __call__(self, fitness: Array) -> Array:
        return fitness[0].mean(axis=1)


class Sum(Aggregate):
    def __call__(self, fitness: Array) -> Array:
        return fitness.sum(axis=(0, 2))


class Saturating(Aggregate):
    def __call__(self, fitness: Array) -> Array:
        return np.minimum(fitness.mean(axis=(0, 2)), 4.0)


class Geometric(Aggregate):
    def __call__(self, fitness: Array) -> Array:
        with np.errstate(all="ignore"):
            return np.exp(np.log(fitness).mean(axis=(0, 2)))


class RankAlone(Aggregate):
    def __call__(self, fitness: Array) -> Array:
        return fitness.mean(axis=(0, 2))

    def in_population(self, fitness: Array) -> Array:
        return np.argsort(np.argsort(self(fitness))).astype(np.float64)


class EveryOther(Aggregate):
    def __call__(self, fitness: Array) -> Array:
        return fitness.mean(axis=(0, 2))

    def models(self, count: int, generation: int) -> IntArray:
        return np.arange(generation % 2, count, 2)


class Boastful(Aggregate):
    mean_of_one = True

    def __call__(self, fitness: Array) -> Array:
        return 0.5 * (fitness.min(axis=(0, 2)) + fitness.mean(axis=(0, 2)))


class Hasty(Aggregate):
    def __call__(self, fitness: Array) -> Array:
        return fitness.mean(axis=(0, 2))

    def at_most(self, fitness: Array, count: int) -> Array:
        return self(fitness)


BROKEN: list[tuple[type[Aggregate], Callable[..., None], str]] = [
    (SinglePrecision, kit.it_gives_one_number_for_each_candidate, r"expected \(7,\) float64, got \(7,\) float32"),
    (SpreadOfMany, kit.one_model_and_one_trial_are_enough, "expected one finite number, got"),
    (Sorting, kit.it_is_pure, "call overwrites its arguments"),
    (Comparing, kit.candidates_are_independent, "changes with the other candidates"),
    (FirstModel, kit.order_does_not_matter, "other models first gives another result"),
    (Sum, kit.equal_fitness_is_the_result, "2.5 everywhere becomes"),
    (Saturating, kit.a_gain_everywhere_is_a_gain, "does not raise it"),
    (Geometric, kit.bad_luck_everywhere_counts, "expected finite numbers, got"),
    (RankAlone, kit.a_population_is_ranked_fairly, r"2.5 everywhere becomes \[0"),
    (EveryOther, kit.the_generation_decides_the_models, r"expected some of 1 models in rising order, got \[\]"),
    (Boastful, kit.what_it_says_of_one_model_holds, "expected the means over the trials, "),
    (Hasty, kit.a_part_bounds_the_whole, "from 1 of 3 models it is .*, and with all of them"),
]


@pytest.mark.parametrize("name", aggregates.names())
def test_every_aggregate_keeps_every_sentence(name: str) -> None:
    check_aggregate(name)


def test_a_rule_over_the_spread_of_the_trials_keeps_every_sentence(register: Callable[..., Any]) -> None:
    register(aggregates, "cautious", Cautious)
    results = list(run_aggregate_checks("cautious"))
    assert broken(results) == {}
    assert len(results) == 1 + len(kit.CHECKS)


@pytest.mark.parametrize(("made", "check", "reason"), BROKEN)
def test_a_broken_aggregate_is_caught_with_the_one_sentence_it_breaks(
    made: type[Aggregate], check: Callable[..., None], reason: str, register: Callable[..., Any]
) -> None:
    register(aggregates, "broken", made)
    found = broken(run_aggregate_checks("broken"))
    assert list(found) == [sentence(check)]
    with pytest.raises(ContractViolation, match=f"aggregate 'broken' breaks 1 of .*\n- .*{reason}"):
        check_aggregate("broken")


def test_every_sentence_has_something_that_breaks_it() -> None:
    assert {check for _, check, _ in BROKEN} == set(kit.CHECKS)


def test_a_name_that_nobody_has_is_the_callers_mistake() -> None:
    with pytest.raises(UnknownName, match="no aggregate is called 'lowest'"):
        check_aggregate("lowest")


def test_what_cannot_be_made_is_the_only_verdict(register: Callable[..., Any]) -> None:
    class Unmakeable(Cautious):
        def __init__(self) -> None:
            raise ZeroDivisionError("no reason")

    register(aggregates, "broken", Unmakeable)
    ((statement, reason),) = broken(run_aggregate_checks("broken")).items()
    assert statement == "It is made from its name and parameters"
    assert reason.startswith("ZeroDivisionError: no reason (test_aggregate_kit.py, line ")
    assert len(list(run_aggregate_checks("broken"))) == 1
