"""The reward of an environment that no table knows: it is put into each state and asked, or refused."""

from __future__ import annotations

from typing import Any, ClassVar

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

from hardware.simulators.gymnasium_robot import GymnasiumRobot
from hardware.simulators.gymnasium_task import EnvironmentTask
from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.errors import IncompatibleTask, InvalidArgument
from sysid_evo.randomness import trial_seeds
from sysid_evo.testing import check_task
from sysid_evo.testing.examples import pendulum
from tests.fixtures import environments as small

NAME = "Slider-v0"
ENDS = 1.5


class Slider(gymnasium.Env[Any, Any]):
    """A block on a floor: keeps position and speed in ``state``; a push left or right."""

    metadata: ClassVar[dict[str, Any]] = {"render_modes": [], "render_fps": 10}

    def __init__(self, forgetful=False):
        self.observation_space = spaces.Box(-np.inf, np.inf, (2,))
        self.action_space = spaces.Discrete(2)
        self.forgetful, self.steps = forgetful, 0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.state = self.np_random.uniform(-0.5, 0.5, 2)
        return self.state.astype(np.float32), {}

    def step(self, action):
        position, speed = self.state
        self.steps += 1
        self.state = np.array([position + 0.1 * speed, 0.9 * speed + (0.3 if action else -0.3)])
        reward = 1.0 - position**2 - 0.1 * speed**2 + (0.01 * self.steps if self.forgetful else 0.0)
        return self.state.astype(np.float32), float(reward), bool(abs(self.state[0]) > ENDS), False, {}


@pytest.fixture(autouse=True, scope="module")
def registered():
    if NAME not in gymnasium.registry:
        gymnasium.register(NAME, entry_point=Slider, max_episode_steps=40)
        gymnasium.register("Forgetful-v0", entry_point=Slider, max_episode_steps=40, kwargs={"forgetful": True})
    small.register()


def test_rewards_starts_and_ends_are_those_of_the_environment():
    robot = GymnasiumRobot(id=NAME)
    task = EnvironmentTask(id=NAME)
    controller = RecurrentNetwork(hidden=3).bind_to(task.bind(robot.system))
    parameters = np.random.default_rng(1).standard_normal((3, controller.n_parameters))
    seeds = trial_seeds(2, 3)
    found = robot.runner().run(RecurrentNetwork(hidden=3), parameters, task, seeds, record=True)
    lengths = set()
    with robot.simulator.open() as session:
        for trajectory, fitness, seed in zip(found.trajectories, found.fitness.ravel(), np.tile(seeds, 3), strict=True):
            np.testing.assert_allclose(trajectory.states[0], session.reset(int(seed)), atol=1e-6)
            total = sum(max(session.step(control)[1], task.worst / 40) for control in trajectory.controls)
            assert fitness == pytest.approx(total, abs=1e-3)
            lengths.add(len(trajectory.controls))
    assert task.horizon == 40
    assert max(lengths) <= 40


def test_the_task_keeps_the_contract_on_the_robot_s_system():
    check_task("environment", GymnasiumRobot(id=NAME).system, id=NAME, horizon=12)


def test_what_is_below_the_least_counts_as_the_least():
    robot = GymnasiumRobot(id=NAME)
    task = EnvironmentTask(id=NAME, least=-2.0, horizon=5).bind(robot.system)
    before, control = np.array([[50.0, 0.0], [0.0, 0.0]]), np.zeros((2, 1))
    trial, _ = task.advance(task.begin(trial_seeds(1, 2)), before, before, control=control)
    np.testing.assert_allclose(task.fitness(trial), [-2.0, 1.0])
    assert trial.alive.tolist() == [False, True]
    assert task.worst == -10.0


def test_what_cannot_be_asked_is_refused_with_what_to_do():
    with pytest.raises(IncompatibleTask, match=r"has no attribute state.*register_reward"):
        EnvironmentTask(id=small.NAME)
    with pytest.raises(IncompatibleTask, match=r"went on in two ways.*register_reward"):
        EnvironmentTask(id="Forgetful-v0")
    with pytest.raises(InvalidArgument, match="no environment can be made of 'Nothing-v9'"):
        EnvironmentTask(id="Nothing-v9")
    with pytest.raises(InvalidArgument, match="the least reward of CartPole-v1 is known, 0"):
        EnvironmentTask(id="CartPole-v1", least=-1.0)
    with pytest.raises(IncompatibleTask, match="needs 2 states, those in which the environment keeps itself"):
        EnvironmentTask(id=NAME).bind(pendulum())
