"""Of candidates that have all the fitness there is, the one that stays inside the data and lasts is chosen."""

import numpy as np
import pytest

from sysid_evo.data import Dataset
from sysid_evo.engine import DynamicsRunner
from sysid_evo.evolution import Champion, ControllerEvolution, Finalist, Scores, choose, evolve_controller
from sysid_evo.evolution.margins import best_candidate, has_all_fitness, lasting_fitness, margins_of
from sysid_evo.models.base import make_model
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import Spec
from sysid_evo.registry.registry import tasks
from sysid_evo.system import Channel, System
from sysid_evo.tasks.reward import register_reward

CART = System((Channel("position", "m"), Channel("speed", "m/s")), (Channel("force", "N", -1.0, 1.0),), 0.1)


@pytest.fixture(scope="module", autouse=True)
def _every_step_gives_one():
    """The task `TASK`, in which all controllers have all the fitness there is."""
    register_reward("margins_of_one", min_reward=0.0, horizon=60)(lambda position, speed: 1.0)
    yield
    tasks.forget("margins_of_one")


TASK, LINEAR = Spec("margins_of_one"), Spec("linear")
HOLDS, DRIFTS = np.array([0.0, -1.0, -1.0, 0.0]), np.array([0.0, 0.0, -0.2, 0.5])


@pytest.fixture(scope="module")
def cart():
    """A linear model of a cart that was recorded within 0.3 m of the middle."""
    rng = np.random.default_rng(0)
    states, controls = [np.zeros(2)], []
    for _ in range(600):
        controls.append(np.clip(-3.0 * states[-1][:1] - 2.0 * states[-1][1:] + rng.normal(0.0, 0.5, 1), -1.0, 1.0))
        position, speed = states[-1]
        states.append(np.array([position + 0.1 * speed, 0.9 * speed + 0.1 * controls[-1][0]]))
    data = Dataset.from_arrays(CART, [np.array(states)], [np.array(controls)])
    return make_model("linear").fit(data, rng=rng)


def finalist(parameters):
    return Finalist("", 0, 1.0, parameters)


@pytest.mark.parametrize("order", [1, -1])
def test_of_two_equal_claims_the_one_that_does_not_drift_to_the_end_is_chosen(cart, order):
    found = (finalist(DRIFTS), finalist(HOLDS))[::order]
    mine = Champion(
        "mine", found[0].parameters, ("other",), "min", 0, np.empty((0, 3)),
        controller=LINEAR, task=TASK, system=CART, finalists=found,
    )  # fmt: skip
    best = choose([(mine, {"a": DynamicsRunner(cart), "b": DynamicsRunner(cart)})], seed=1, trials=8)
    assert [one.forecast for one in best.finalists] == pytest.approx([1.0, 1.0])
    np.testing.assert_array_equal(best.parameters, HOLDS)


def test_a_drift_costs_margin_and_noise_is_the_same_for_all(cart):
    seeds = trial_seeds(0, 8)
    runners = {"a": DynamicsRunner(cart)}
    both = lasting_fitness(np.stack([DRIFTS, HOLDS]), runners, LINEAR, TASK, CART, seeds)
    np.testing.assert_allclose(both[:, 0], [1.0, 1.0])  # the mean of one a step, over a longer horizon
    assert both[0, 1] > both[1, 1] + 0.3
    np.testing.assert_allclose(margins_of(both), 1.0 - both[:, 1])
    np.testing.assert_array_equal(lasting_fitness(HOLDS[None], runners, LINEAR, TASK, CART, seeds)[0], both[1])


def test_the_champion_of_an_evolution_that_reaches_everything_stays_inside_the_data(cart):
    settings = ControllerEvolution(
        generations=3, trials=2, selection_trials=4, controller="linear", task=TASK, strategy="cma_es(sigma=1.0)"
    )
    made = evolve_controller("c", {"a": cart}, CART, settings, seed=0)
    seeds, everyone = trial_seeds(5, 8), np.stack([made.parameters, *made.population])
    margin = margins_of(lasting_fitness(everyone, {"a": DynamicsRunner(cart)}, LINEAR, TASK, CART, seeds))
    assert margin[0] > np.median(margin[1:])


def test_only_nearly_the_highest_fitness_in_nearly_all_trials_is_everything():
    full, often, varied = np.full(10, 9.95), np.r_[np.full(8, 10.0), 0.0, 0.0], np.linspace(6.0, 10.0, 10)
    assert has_all_fitness(np.stack([full, often, varied]), 0.0).tolist() == [True, False, False]
    assert not has_all_fitness(np.zeros((2, 4)), 0.0).any()  # the worst is not everything


def test_a_higher_fitness_counts_more_than_any_margin():
    by_trial = np.stack([np.full(4, 10.0), np.full(4, 10.0), np.full(4, 9.0)])
    scores = Scores(np.array([9.96, 10.0, 9.0]), by_trial=by_trial)
    assert best_candidate(scores, 0.0, lambda rows: -rows.astype(float)) == 0
    assert best_candidate(Scores(np.array([9.0, 10.0, 9.0]), by_trial=by_trial), 0.0, lambda *_: 1 / 0) == 1
