"""The task of an environment: its reward, its starts and its ends are those of the environment itself."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hardware.simulators.gymnasium_robot import GymnasiumRobot
from hardware.simulators.gymnasium_task import RULES, EnvironmentTask
from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.engine import rollout
from sysid_evo.errors import IncompatibleTask, InvalidArgument
from sysid_evo.models.base import make_model
from sysid_evo.randomness import trial_seeds
from sysid_evo.testing import check_task
from sysid_evo.testing.examples import pendulum

NAMES = ("Pendulum-v1", "CartPole-v1", "MountainCar-v0", "MountainCarContinuous-v0", "Acrobot-v1")


@pytest.mark.parametrize("name", NAMES)
def test_the_task_keeps_the_contract_compiled_and_not(name):
    check_task("environment", GymnasiumRobot(id=name).system, id=name, horizon=30)


@pytest.mark.parametrize("name", NAMES)
def test_reward_and_end_of_every_step_are_those_of_the_environment(name):
    robot = GymnasiumRobot(id=name)
    task = EnvironmentTask(id=name).bind(robot.system)
    rng = np.random.default_rng(0)
    low = np.array([max(c.low, -6.0) for c in robot.system.states])
    high = np.array([min(c.high, 6.0) for c in robot.system.states])
    ends = set()
    with robot.simulator.open() as session:
        for _ in range(300):
            state = session.reset(0, rng.uniform(low, high))
            control = robot.system.actuate(rng.uniform(-1.0, 1.0, robot.system.nu))
            after, reward, over, _ = session.step(control)
            trial, _ = task.advance(task.begin(trial_seeds(0, 1)), state[None], after[None], control=control[None])
            assert task.fitness(trial)[0] == pytest.approx(reward, abs=1e-4)
            assert trial.alive[0] == (not over)
            ends.add(over)
    assert ends == ({False} if name == "Pendulum-v1" else {True, False})


@pytest.mark.parametrize("name", NAMES)
def test_a_trial_begins_where_the_environment_does_with_its_seed_and_lasts_as_long(name):
    robot = GymnasiumRobot(id=name)
    task = EnvironmentTask(id=name).bind(robot.system)
    seeds = trial_seeds(4, 3)
    with robot.simulator.open() as session:
        for start, seed in zip(task.begin(seeds).state, seeds, strict=True):
            np.testing.assert_allclose(np.cos(start), np.cos(session.reset(int(seed))), atol=1e-6)
        assert session._env.spec.max_episode_steps == task.horizon


def test_the_sum_of_an_episodes_rewards_is_the_fitness_on_the_robot():
    robot = GymnasiumRobot(id="Pendulum-v1")
    task = EnvironmentTask(id="Pendulum-v1")
    parameters = np.random.default_rng(1).standard_normal((2, 3 * (4 + 3 + 1)))
    seeds = trial_seeds(8, 2)
    found = robot.runner().run(RecurrentNetwork(hidden=3), parameters, task, seeds, record=True)
    with robot.simulator.open() as session:
        for trajectory, fitness in zip(found.trajectories, found.fitness.ravel(), strict=True):
            session.reset(0, trajectory.states[0])
            total = sum(session.step(control)[1] for control in trajectory.controls)
            assert fitness == pytest.approx(total, abs=1e-2)


def test_a_good_model_gives_the_fitness_of_the_environment():
    robot, task = GymnasiumRobot(id="CartPole-v1"), EnvironmentTask(id="CartPole-v1", horizon=60)
    model = make_model("linear").fit(robot.record(seed=0, duration=60.0).dataset)
    parameters = np.random.default_rng(1).standard_normal((8, 3 * (5 + 3 + 1)))
    given: tuple[Any, ...] = (RecurrentNetwork(hidden=3), parameters, task, trial_seeds(3, 5))
    own, on_robot = rollout(model, *given), robot.runner().run(*given)
    assert own.engine == "compiled float32"
    np.testing.assert_allclose(own.fitness.mean(axis=1), on_robot.fitness.mean(axis=1), atol=1.5)


def test_what_does_not_fit_is_refused_with_what_would():
    with pytest.raises(InvalidArgument, match="a horizon of at least one step, got 0"):
        EnvironmentTask(horizon=0)
    with pytest.raises(IncompatibleTask, match="needs the states position, speed, angle, angular_speed"):
        EnvironmentTask(id="CartPole-v1").bind(pendulum())


def test_no_reward_is_below_the_worst():
    assert EnvironmentTask(id="Pendulum-v1", horizon=10).worst == pytest.approx(-162.7, abs=0.1)
    assert all(rules.least <= 0.0 for rules in RULES.values())
