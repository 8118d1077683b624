"""A search ends when its candidates are equal, and forgets fitness when what is asked for changes."""

import numpy as np
import pytest

from sysid_evo.artefacts import CheckpointFile
from sysid_evo.engine import DynamicsRunner
from sysid_evo.evolution import ControllerEvolution, evolve, evolve_controller, loop
from sysid_evo.evolution.loop import Convergence, Generation
from sysid_evo.evolution.strategies.mu_plus_lambda import MuPlusLambda
from sysid_evo.models.base import make_model
from tests.fixtures.checkpoints import Stop, StopAfter
from tests.fixtures.evolutions import assert_same

SETTINGS = ControllerEvolution(
    generations=40,
    trials=2,
    repeats=2,
    selection_trials=3,
    controller="recurrent(hidden=2)",
    task="point_to_point(horizon=40)",
    strategy="mu_plus_lambda(parents=4, children=4)",
)


def scored(*fitness):
    return Generation(0, np.zeros((len(fitness), 1)), np.array(fitness))


def test_parents_that_are_not_asked_again_do_not_live_on_the_fitness_of_another_objective():
    strategy = MuPlusLambda(n_parameters=2, seed=1, parents=5, children=5, reevaluate=False)

    def hill(population, generation):
        flat = np.maximum(0.0, 1.0 - np.abs(population - 3.0).max(axis=1) / 2.0)
        return population[:, 0] + 1000.0 if generation < 3 else flat

    for generation in evolve(strategy, hill, 10):
        if generation.index == 2:
            assert len(strategy.ask()) == 5
            strategy.forget_fitness()
            assert len(strategy.ask()) == 10
    assert (np.asarray(strategy.state["parents_fitness"]) < 1.1).all()


def test_a_search_is_over_when_half_of_the_candidates_have_had_nearly_the_most_for_twenty_generations():
    convergence = Convergence()
    full, not_quite = scored(2.0, 1.9999, 0.0, 0.0), scored(2.0, 1.999, 1.999, 0.0)
    for generation in (*[full] * 19, not_quite, *[full] * 19):
        convergence.tell(generation)
        assert not convergence.reached
    convergence.tell(full)
    assert convergence.reached


def test_a_search_that_still_rises_is_not_over():
    convergence = Convergence()
    for number in range(60):
        convergence.tell(scored(1.0 + 0.01 * number, 1.0 + 0.01 * number, 0.0))
    convergence.tell(scored(1.0, 1.0, 1.0))
    assert not convergence.reached


def test_a_search_among_equals_goes_on():
    convergence = Convergence()
    for _ in range(30):
        convergence.tell(scored(-500.0, -500.0))
    assert not convergence.reached


def test_a_run_ends_when_its_search_has_converged_and_resumes_to_the_same_end(car_data, tmp_path, monkeypatch):
    monkeypatch.setattr(loop, "EQUAL_SHARE", 0.0)
    runners = {"linear": DynamicsRunner(make_model("linear").fit(car_data, rng=0))}

    def evolved(**options):
        return evolve_controller("c", runners, car_data.system, SETTINGS, seed=3, **options)

    champion = evolved()
    assert len(champion.history) == 22  # the first two have equals alone
    with pytest.raises(Stop):
        evolved(checkpoint=CheckpointFile(tmp_path / "c"), progress=StopAfter(20))
    assert_same(evolved(checkpoint=CheckpointFile(tmp_path / "c")), champion)
