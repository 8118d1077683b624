"""MAP-Elites, whose library takes seconds to load, and every strategy in an evolution that is stopped."""

from dataclasses import replace

import numpy as np
import pytest

from sysid_evo import extras
from sysid_evo.artefacts import CheckpointFile
from sysid_evo.errors import InvalidArgument, MissingExtra
from sysid_evo.evolution import Scores, evolve
from sysid_evo.evolution.strategies.map_elites import MapElites
from sysid_evo.registry import strategies
from tests.fixtures.checkpoints import Stop, StopAfter
from tests.fixtures.evolutions import CONTROLS, NAMES, SETTINGS, assert_same, evolved, trap


def made(**arguments):
    strategy = MapElites(n_parameters=3, **{"seed": 1, "population": 20, **arguments})
    strategy.prepare(behaviour_names=NAMES, control_names=CONTROLS, generations=100)
    return strategy


def shares(*biases):
    """Descriptors of candidates by the biases of speed and drive, without steering."""
    rows = [[(1 + s) / 2, (1 - s) / 2, (1 + d) / 2, (1 - d) / 2, 0.5, 0.5] for s, d in biases]
    return np.array(rows)


@pytest.mark.parametrize("strategy", strategies.names())
def test_an_evolution_that_is_stopped_again_and_again_ends_the_same(strategy, tmp_path):
    settings = replace(SETTINGS, generations=8, strategy=strategy)
    for after in (1, 5, 11):
        with pytest.raises(Stop):
            evolved(settings, CheckpointFile(tmp_path / "c"), progress=StopAfter(after))
    assert_same(evolved(settings, CheckpointFile(tmp_path / "c")), evolved(settings))


def test_each_cell_keeps_its_best():
    strategy = made(again=0)
    population = np.arange(15.0).reshape(5, 3)
    behaviour = shares((0.9, 0.9), (0.95, 0.85), (0.9, -0.9), (-0.9, 0.9), (-0.9, 0.9))
    strategy.tell(population, np.array([1.0, 2.0, 0.0, 5.0, 4.0]), behaviour)
    np.testing.assert_array_equal(strategy.elite, population[[3, 1, 2]])
    assert strategy.status == "3 of 100 cells, best drive +0.9, speed -0.9"
    strategy.tell(population[:1] + 0.5, np.array([1.5]), behaviour[:1])  # not as good as who is there
    strategy.tell(population[:1] + 0.7, np.array([0.7]), behaviour[2:3])  # better
    np.testing.assert_array_equal(strategy.elite, [population[3], population[1], population[0] + 0.7])


def test_the_children_are_near_a_stored_candidate():
    strategy = made(again=0, sigma=1e-3, line=0.0, population=40)
    population = np.array([[5.0, 5.0, 5.0], [-5.0, 0.0, 5.0], [0.0, 0.0, 0.0]])
    strategy.tell(population, np.array([1.0, 9.0, 0.5]), shares((0.9, 0.9), (-0.9, -0.9), (0.9, 0.9)))
    apart = np.abs(strategy.ask()[:, None] - population).max(axis=2)
    assert (apart.min(axis=1) < 0.01).all()
    assert set(apart.argmin(axis=1)) == {0, 1}  # both cells, and not who lost
    stretched = made(again=0, sigma=1e-3, line=1.0, population=40)
    stretched.tell(population, np.array([1.0, 9.0, 0.5]), shares((0.9, 0.9), (-0.9, -0.9), (0.9, 0.9)))
    on_the_line = stretched.ask() @ np.array([1.0, -2.0, 1.0])  # 0 at the first, 0 at the second, and between
    np.testing.assert_allclose(on_the_line, 0.0, atol=0.02)
    assert np.abs(stretched.ask()[:, None] - population).max(axis=2).min(axis=1).max() > 1.0


def test_the_best_are_asked_again_and_their_mean_counts():
    strategy = made(again=1, population=2)
    lucky, steady = np.full((1, 3), 7.0), np.full((1, 3), 3.0)
    strategy.tell(np.concatenate([lucky, steady]), np.array([9.0, 6.0]), shares((0.9, 0.9), (-0.9, -0.9)))
    asked = strategy.ask()
    np.testing.assert_array_equal(asked[2:], lucky)
    strategy.tell(asked, np.array([-1.0, -1.0, 1.0]), shares((0.1, 0.1), (0.1, 0.1), (0.9, 0.9)))
    np.testing.assert_array_equal(strategy.elite[:2], [steady[0], lucky[0]])
    assert strategy.state["scores"].tolist().count(5.0) == 1
    strategy.tell(strategy.ask(), np.array([-1.0, -1.0, 6.0]), shares((0.1, 0.1), (0.1, 0.1), (-0.9, -0.9)))
    np.testing.assert_array_equal(strategy.ask()[2:], steady)


def test_what_was_forgotten_is_asked_again_first_and_counts_by_what_it_scores_then():
    strategy = made(again=1, population=2)
    population = np.arange(6.0).reshape(2, 3)
    strategy.tell(population, np.array([90.0, 60.0]), shares((0.9, 0.9), (-0.9, -0.9)))
    strategy.forget_fitness()
    for place in (1, 0):  # in the order of the cells
        asked = strategy.ask()
        np.testing.assert_array_equal(asked[2], population[place])
        where = (0.9, 0.9) if place == 0 else (-0.9, -0.9)
        strategy.tell(asked, np.array([-1.0, -1.0, 4.0 - place]), shares((0.1, 0.1), (0.1, 0.1), where))
    np.testing.assert_array_equal(strategy.elite[:2], population)
    assert sorted(strategy.state["scores"].tolist()) == [-1.0, 3.0, 4.0]


def test_it_finds_the_high_hill_next_to_the_broad_one_and_keeps_both():
    strategy = made(channels="drive", sigma=0.3, spread=3.0)
    for _ in evolve(strategy, trap, 100):
        pass
    assert float(trap(strategy.elite[:1]).fitness[0]) > 9.5
    found = {name: float(trap(candidates[:1]).fitness[0]) for name, candidates in strategy.finals.items()}
    assert max(found, key=lambda name: found[name]) == "drive +0.9"
    assert found["drive -0.9"] > 4.5


def test_finalists_are_cells_that_do_not_touch_each_with_what_lies_around_it():
    strategy = made(again=0, finalists=2)
    population = np.arange(12.0).reshape(4, 3)
    behaviour = shares((0.9, 0.9), (0.9, 0.7), (0.9, 0.5), (-0.9, -0.9))
    strategy.tell(population, np.array([4.0, 3.0, 2.0, 1.0]), behaviour)
    finals = strategy.finals
    assert list(finals) == ["drive +0.9, speed +0.9", "drive +0.5, speed +0.9"]
    np.testing.assert_array_equal(finals["drive +0.9, speed +0.9"], population[:2])
    np.testing.assert_array_equal(finals["drive +0.5, speed +0.9"], population[[1, 2]])


def test_a_trial_that_diverged_without_bound_is_stored_only_in_an_empty_cell():
    strategy = made(again=0)
    population = np.arange(6.0).reshape(2, 3)
    strategy.tell(population, np.array([-np.inf, -3.0]), shares((0.9, 0.9), (0.9, 0.9)))
    np.testing.assert_array_equal(strategy.elite, population[1:])


def test_a_restored_search_ends_the_same():
    def noisy(population, generation):
        scores = trap(population)
        return Scores(scores.fitness + np.random.default_rng(generation).normal(size=len(population)), scores.behaviour)

    whole, second = made(), made()
    for generation in evolve(whole, noisy, 40):
        if generation.index == 16:
            second.restore(whole.state)
    for _ in evolve(second, noisy, 40, start=17):
        pass
    np.testing.assert_array_equal(whole.elite, second.elite)
    np.testing.assert_array_equal(whole.ask(), second.ask())


def test_what_makes_no_sense_is_refused(monkeypatch):
    with pytest.raises(InvalidArgument, match="map_elites: expected n_parameters, population, bins"):
        made(sigma=0.0)
    with pytest.raises(InvalidArgument, match="one or two of the channels speed, drive, steer, got 'sped'"):
        made(channels="sped").tell(np.zeros((1, 3)), np.zeros(1), shares((0.0, 0.0)))
    with pytest.raises(InvalidArgument, match="map_elites: expected a state with generation, candidates"):
        made().restore({"generation": 1})
    monkeypatch.setattr(extras, "find_spec", lambda module: None)
    with pytest.raises(MissingExtra, match=r"strategy 'map_elites' needs .* pip install \"sysid-evo\[evolution\]\""):
        made()
