"""A task of one function, by hand and in both forms."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from sysid_evo.errors import IncompatibleTask, InvalidArgument, ShapeError
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import tasks
from sysid_evo.tasks import Reward
from sysid_evo.testing import check_task
from sysid_evo.testing.examples import pendulum, switched_car

SEEDS = trial_seeds(1, 3)


def worth(states, controls):
    return np.cos(states[:, 0]) - 0.5 * controls[:, 0] ** 2 + 0.1 * states[:, -1]


def worth_of_one(x, u):
    return math.cos(x[0]) - 0.5 * u[0] ** 2 + 0.1 * x[1]


def worth_of_a_car(x, u):
    return math.cos(x[0]) - 0.5 * u[0] ** 2 + 0.1 * x[2]


def test_fitness_is_the_mean_reward_of_the_states_in_which_controls_are_given():
    task = Reward(worth, lowest=-9.0, horizon=2).bind(pendulum())
    trial: Any = task.begin(SEEDS[:1])
    states = np.array([[[0.0, 1.0]], [[math.pi, 0.0]], [[0.0, 0.0]]])
    for k, control in enumerate((1.0, 2.0)):
        trial, _ = task.advance(trial, states[k], states[k + 1], control=np.array([[control]]))
    assert task.fitness(trial)[0] == pytest.approx((1.0 - 0.5 + 0.1 - 1.0 - 2.0) / 2.0)


def test_a_reward_below_the_lowest_or_not_a_number_counts_as_the_lowest():
    task = Reward(lambda states, controls: states[:, 0], lowest=-2.0, horizon=1).bind(pendulum())
    before = np.array([[-5.0, 0.0], [np.nan, 0.0], [1.0, 0.0]])
    trial, _ = task.advance(task.begin(SEEDS), before, before, control=np.zeros((3, 1)))
    np.testing.assert_array_equal(task.fitness(trial), [-2.0, -2.0, 1.0])
    assert task.worst == -2.0


def test_a_trial_begins_where_start_says_and_is_over_where_ended_says():
    task = Reward(
        worth, start=lambda rng: rng.uniform(1.0, 2.0, 2), ended=lambda states: states[:, 1] > 1.5, lowest=-9.0
    ).bind(pendulum())
    trials = task.begin(SEEDS)
    assert 1.0 <= trials.state.min() < trials.state.max() <= 2.0
    after, _ = task.advance(trials, trials.state, trials.state, control=np.zeros((3, 1)))
    np.testing.assert_array_equal(after.alive, trials.state[:, 1] <= 1.5)
    assert Reward(worth, scalar=worth_of_one, ended=lambda states: states[:, 1] > 1.5).bind(pendulum()).kernel() is None


@pytest.mark.parametrize(("system", "scalar"), [(pendulum(), worth_of_one), (switched_car(), worth_of_a_car)])
def test_the_contract_is_kept_and_the_compiled_form_is_the_reference(system, scalar, register):
    register(tasks, "made_up_reward", lambda: Reward(worth, scalar=scalar, lowest=-2.0, horizon=80))
    check_task("made_up_reward", system)


def test_a_reward_that_fits_nothing_is_refused():
    with pytest.raises(IncompatibleTask, match="needs the state 'height'; the states are angle, angular_speed"):
        Reward(worth, states=("height",)).bind(pendulum())
    with pytest.raises(InvalidArgument, match="finite lowest"):
        Reward(worth, lowest=-np.inf)
    task = Reward(lambda states, controls: states).bind(pendulum())
    with pytest.raises(ShapeError, match="rewards: expected shape"):
        task.advance(task.begin(SEEDS), np.zeros((3, 2)), np.zeros((3, 2)), control=np.zeros((3, 1)))
