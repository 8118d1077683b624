"""Searches that begin anew where they are stuck."""

from __future__ import annotations

import numpy as np
import pytest

from sysid_evo.arrays import Array
from sysid_evo.errors import InvalidArgument
from sysid_evo.evolution import evolve
from sysid_evo.evolution.restarts import Restarts
from sysid_evo.testing import check_strategy

from .test_niches import trap

SMALL = "cma_es(population=8, sigma=1.0)"


def made(**arguments: object) -> Restarts:
    return Restarts(n_parameters=3, **{"seed": 1, "strategy": SMALL, "patience": 15, **arguments})  # type: ignore[arg-type]


def run(strategy: Restarts, generations: int) -> list[int]:
    """Return how many candidates each generation had."""
    return [len(generation.population) for generation in evolve(strategy, trap, generations)]


def test_it_keeps_the_contract_around_any_strategy() -> None:
    check_strategy("restarts", patience=3)
    check_strategy("restarts", strategy="mu_plus_lambda(parents=5, children=5)")


def test_a_start_that_is_stuck_is_followed_by_a_larger_one_from_elsewhere() -> None:
    counts = run(made(), 220)
    sizes = sorted(set(counts))
    assert sizes[:3] == [9, 17, 33]  # twice the candidates, and the mean
    assert counts == sorted(counts)
    assert counts.count(9) > 15


def test_as_long_as_the_fitness_rises_no_start_is_given_up() -> None:
    strategy = made(patience=3)
    for generation in range(40):
        population = strategy.ask()
        strategy.tell(population, np.full(len(population), 1.02**generation))
    assert strategy.status == "start 1, best 1"
    for _ in range(10 + 3):  # the mean of the last ten still rises while older ones leave it
        population = strategy.ask()
        strategy.tell(population, np.full(len(population), 1.02**39))
    assert strategy.status.startswith("start 2")


def test_a_rise_that_is_less_than_a_little_does_not_count() -> None:
    strategy = made(patience=12)
    for generation in range(13):
        population = strategy.ask()
        strategy.tell(population, np.full(len(population), 1.0 + 1e-4 * generation))
    assert strategy.status.startswith("start 2")


def test_what_an_earlier_start_found_is_not_lost() -> None:
    strategy = made(patience=2)
    found: Array | None = None
    while strategy.status.startswith("start 1"):
        population = strategy.ask()
        fitness = np.linspace(7.0, 8.0, len(population))
        strategy.tell(population, fitness)
        found = population[-1].copy()
    for _ in range(2):
        population = strategy.ask()
        strategy.tell(population, np.linspace(0.0, 1.0, len(population)))
    assert found is not None
    np.testing.assert_array_equal(strategy.elite[0], found)
    assert list(strategy.finals) == ["start 1", "start 2"]
    np.testing.assert_array_equal(strategy.finals["start 1"][0], found)


def test_of_many_starts_the_best_are_remembered() -> None:
    strategy = made(patience=1, growth=1.0)
    peaks = [5.0, 1.0, 9.0, 3.0, 2.0, 8.0, 4.0, 7.0, 6.0, 0.5, 0.1]
    for height in peaks:
        for _ in range(2):
            population = strategy.ask()
            strategy.tell(population, np.linspace(height - 0.1, height, len(population)))
    assert len(strategy.finals) == 8
    assert next(iter(strategy.finals)) == "start 3"  # of height 9
    assert "start 10" not in strategy.finals


def test_on_another_task_what_earlier_starts_scored_is_forgotten() -> None:
    strategy = made(patience=2)
    while strategy.status.startswith("start 1"):
        population = strategy.ask()
        strategy.tell(population, np.full(len(population), 90.0))
    strategy.forget_fitness()
    population = strategy.ask()
    strategy.tell(population, np.linspace(1.0, 0.0, len(population)))
    assert list(strategy.finals) == ["start 2"]
    np.testing.assert_array_equal(strategy.elite[0], population[0])


def test_no_start_begins_where_too_little_is_left_for_it() -> None:
    strategy = made(patience=5)
    strategy.prepare(behaviour_names=(), control_names=(), generations=9)
    for _ in range(9):
        population = strategy.ask()
        strategy.tell(population, np.ones(len(population)))
    assert strategy.status == "start 1, best 1"


def test_its_starts_find_the_high_hill_that_one_start_misses() -> None:
    one, many = made(growth=1.0, patience=10**6, seed=6), made(growth=1.0, seed=6)
    for strategy in (one, many):
        run(strategy, 200)
    reached = [float(trap(strategy.elite[:1]).fitness[0]) for strategy in (one, many)]
    assert reached[0] == pytest.approx(5.0, abs=0.1)
    assert reached[1] > 9.9


def test_a_search_that_goes_on_from_a_state_after_a_restart_ends_the_same() -> None:
    for before in (5, 90, 150):
        whole, first, second = made(), made(), made()
        for strategy in (whole, first, second):
            strategy.prepare(behaviour_names=(), control_names=(), generations=180)
        run(whole, 180)
        run(first, before)
        second.restore(first.state)
        run(second, 180 - before)
        np.testing.assert_array_equal(whole.elite, second.elite)
        assert whole.status == second.status


def test_the_strategy_inside_is_told_the_behaviour_and_the_fitness_on_each_model() -> None:
    by_model = np.array([[1.0, 0.0, 0.9, 0.0], [0.0, 1.0, 0.9, 0.0]])
    strategy = made(strategy="nsga2(population=4)")
    for _ in range(2):
        population = strategy.ask()
        strategy.tell(population, np.zeros(len(population)), by_model=np.tile(by_model, len(population) // 4))
    kept = strategy.state["strategy/parents"]
    assert isinstance(kept, np.ndarray)
    assert not (kept[:, None] == population[[3, 7]]).all(axis=2).any()  # those that are beaten on both models


def test_what_makes_no_sense_is_refused() -> None:
    with pytest.raises(InvalidArgument, match="restarts: expected n_parameters, patience, growth >= 1"):
        made(growth=0.5)
    with pytest.raises(InvalidArgument, match="strategy 'niches' has no parameter population, parents, children"):
        made(strategy="niches")
    with pytest.raises(InvalidArgument, match="restarts: expected a state with generation, starts"):
        made().restore({"generation": 1})
    state = dict(made().state)
    with pytest.raises(InvalidArgument, match="the state lacks 0/best"):
        made().restore({name: value for name, value in state.items() if name != "0/best"})
