"""Islands in niches of behaviour."""

import numpy as np
import pytest

from sysid_evo.errors import InvalidArgument
from sysid_evo.evolution import Scores, evolve
from sysid_evo.evolution.strategies.niches import Island, Niches, _converged
from tests.fixtures.evolutions import CONTROLS, NAMES, described, trap


def prepared(generations=100, **arguments):
    strategy = Niches(n_parameters=3, seed=1, **{"strategy": "cma_es(population=20, sigma=2.0)", **arguments})
    strategy.prepare(behaviour_names=NAMES, control_names=CONTROLS, generations=generations)
    return strategy


def test_a_niche_finds_the_high_hill_next_to_the_broad_one():
    strategy = prepared()
    for _ in evolve(strategy, trap, 100):
        pass
    found = {name: float(trap(candidates).fitness.max()) for name, candidates in strategy.finals.items()}
    assert found["drive above"] > 9.9
    assert max(fitness for name, fitness in found.items() if name != "drive above") == pytest.approx(5.0, abs=0.1)
    np.testing.assert_allclose(strategy.elite[0], 2.0, atol=0.05)
    assert strategy.status == "2 niches, best with drive mostly above neutral"


def test_the_initial_phase_searches_both_sides_of_every_control_and_two_classes_continue():
    strategy = prepared()
    assert [island.name for island in strategy.islands] == ["drive above", "drive below", "steer above", "steer below"]
    for _ in evolve(strategy, trap, 20):
        pass
    kept = [island.name for island in strategy.active]
    assert len(kept) == 2
    assert "drive above" in kept  # the slow class is not lost: all others went backwards
    ages = {island.name: island.age for island in strategy.islands}
    assert set(ages.values()) == {10}  # every island had the same share of the initial phase


def test_an_island_ranks_candidates_outside_its_niche_below_all_inside():
    reported = []

    class Listening:
        elite = np.zeros((1, 3))

        def tell(self, population, fitness):
            reported.append(fitness)

    island = Island("x", "drive", 1, Listening(), np.zeros((1, 3)), np.zeros(1), behaviour_class=0)
    fitness = np.array([1.0, 9.0, 8.0, -3.0])
    island.tell(np.arange(12.0).reshape(4, 3), fitness, np.zeros((4, 6)), np.array([0.0, 0.1, 0.4, 0.0]))
    assert list(np.argsort(-reported[0])) == [0, 3, 1, 2]  # inside by fitness, outside by how far
    np.testing.assert_array_equal(island.best[0], [0.0, 1.0, 2.0])
    assert island.smoothed_quantile == pytest.approx(np.quantile([1.0, -3.0], 0.8))
    np.testing.assert_array_equal(fitness, [1.0, 9.0, 8.0, -3.0])


@pytest.mark.parametrize(("failed", "quantile"), [(0, 16.8), (12, 16.8), (17, -np.inf), (21, -np.inf)])
def test_the_quantile_of_an_island_whose_candidates_mostly_fail_is_minus_infinity(failed, quantile):
    island = prepared().islands[0]
    population = island.strategy.ask()
    fitness = np.where(np.arange(21) < failed, -np.inf, np.arange(1.0, 22.0) - 0.2)
    outside = np.zeros(21)
    outside[20] = 0.1
    island.tell(population, fitness, described(population), outside if failed == 21 else np.zeros(21))
    assert island.smoothed_quantile == quantile


def test_the_quantile_of_an_empty_niche_is_minus_infinity():
    strategy = prepared()

    def forwards_only(population, _):
        ahead = np.tile([1.0, 0.0, 1.0, 0.0, 0.5, 0.5], (len(population), 1))
        return Scores(-(population**2).sum(axis=1), ahead)

    for _ in evolve(strategy, forwards_only, 20):
        pass
    assert strategy.islands[1].smoothed_quantile == -np.inf
    assert "drive below" not in [island.name for island in strategy.active]
    assert len(strategy.active) == 2


def test_the_control_that_separates_behaviour_continues_although_islands_of_another_score_more():
    strategy = prepared()
    strategy.islands  # noqa: B018  # makes the islands
    biases = {
        "drive above": (0.9, 0.1),
        "drive below": (0.0, 1.0),
        "steer above": (0.6, 0.4),
        "steer below": (0.4, 0.6),
    }
    for island, quantile in zip(strategy.islands, (8.0, 11.0, 12.0, 12.5), strict=True):
        above, below = biases[island.name]
        island.quantiles = [quantile]
        forwards = (1.0, 0.0) if island.name in ("drive above", "steer below") else (0.0, 1.0)
        drive, steer = ((above, below), (0.5, 0.5)) if island.channel == "drive" else (forwards, (above, below))
        island.behaviour = np.array([*forwards, *drive, *steer])
    assert strategy._choose() == [1, 0]


def test_a_stagnated_island_is_replaced_by_a_restart_and_the_best_continue_at_the_end():
    strategy = prepared(generations=400)
    for generation in evolve(strategy, trap, 400):
        if generation.index == 300:
            before_end = {island.name: island.age for island in strategy.active}
    assert {"drive above", "drive above #2"} <= set(before_end)  # the first was at the top long ago
    asked = {island.name: island.age for island in strategy.active}
    last = [name for name in asked if asked[name] != before_end[name]]
    assert len(last) <= 4  # those that ran on, and the two that are best at the end
    assert any(name.startswith("drive above") for name in last)
    assert set(strategy.finals) == set(asked)


def test_an_increase_of_less_than_one_percent_is_no_improvement():
    island = prepared().islands[0]

    def reaches(fitness):
        """Return the generation of the last rise when a generation has this fitness, and the 20 after it."""
        for _ in range(21):
            population = island.strategy.ask()
            everywhere = np.full(len(population), fitness)
            island.tell(population, everywhere, described(population), np.zeros(len(population)))
        return island.peak_age

    assert (reaches(100.0), reaches(100.9)) == (1, 1)
    assert reaches(101.1) > 42


def test_a_class_has_converged_when_several_islands_reached_the_same_fitness():
    assert not any(_converged(reached) for reached in ([], [12.0], [12.0, 11.5]))
    assert _converged([12.0, 11.7])
    assert _converged([-10.0, -10.2])


def test_a_converged_class_gets_no_restart_while_others_have_not_converged():
    strategy = prepared()
    strategy.islands  # noqa: B018  # makes the islands
    strategy._chosen = [0, 1]
    for number_of_class, peaks in ((0, (5.0, 9.0, 7.0)), (1, (10.0, 10.1))):
        numbers = [number_of_class, *(strategy._restart(number_of_class) for _ in peaks[1:])]
        for number, peak in zip(numbers, peaks, strict=True):
            island = strategy.islands[number]
            island.age, island.peak, island.peak_age = 1000, peak, 100
    assert strategy._next_restart() == 0  # although it has more islands and reached less
    strategy.islands[1].peak = 12.0  # its two islands differ now
    assert strategy._next_restart() == 1  # fewer islands
    strategy._restart(1)
    assert strategy._next_restart() == 1  # as many, and it reached more


def test_other_channels_can_tell_niches_apart():
    strategy = prepared(channels="speed")
    assert [island.name for island in strategy.islands] == ["speed above", "speed below"]
    with pytest.raises(InvalidArgument, match="expected channels among speed, drive, steer, got 'sped'"):
        prepared(channels="sped").ask()


def test_without_descriptors_there_is_one_niche_with_an_island_for_each_slot():
    strategy = Niches(n_parameters=3, seed=1)
    assert [island.name for island in strategy.islands] == ["anything", "anything #2"]
    assert strategy.ask().shape == (102, 3)


def test_a_state_of_another_plan_is_refused():
    state = dict(prepared().state)
    with pytest.raises(InvalidArgument, match="expected a state with generation, behaviour_classes, chosen, running"):
        prepared().restore({"generation": 3})
    with pytest.raises(InvalidArgument, match="expected behaviour classes that begin with 0 to 1, got"):
        prepared(channels="speed").restore(state)
    with pytest.raises(InvalidArgument, match="expected running, chosen below 4"):
        prepared().restore({**state, "running": np.array([9.0])})


def test_a_search_restored_from_any_state_continues_identically():
    whole, places, states = prepared(generations=400), (3, 20, 150, 330), {}
    for generation in evolve(whole, trap, 345):
        states[generation.index + 1] = whole.state
    for before in places:
        restored = prepared(generations=400)
        restored.restore(states[before])
        for _ in evolve(restored, trap, before + 15, start=before):
            pass
        assert set(restored.state) == set(states[before + 15])
        for name, value in states[before + 15].items():
            np.testing.assert_array_equal(restored.state[name], value, err_msg=name)
