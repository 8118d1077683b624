"""An exported controller of an environment takes its raw observation and gives its raw action, in a plain loop."""

import runpy

import gymnasium
import numpy as np
import pytest

from hardware.simulators.gymnasium_robot import GymnasiumRobot
from sysid_evo import make_controller, make_task
from sysid_evo.evolution import Champion
from sysid_evo.export import c_text, exported_controller, python_text
from sysid_evo.randomness import trial_seeds
from sysid_evo.tasks.task import learn_task
from tests.fixtures import environments

ROBOTS = {
    "cos and sin": {"id": "Pendulum-v1"},
    "levels": {"id": "CartPole-v1"},
    "levels and two angles": {"id": "Acrobot-v1"},
    "neutral value": {"id": "MountainCarContinuous-v0"},
    "no angle": {"id": "Rotor-v0"},
    "angle of a user": {"id": "Rotor-v0", "angle": "1,2"},
    "numbers from -1": {"id": "Rotor-v0", "settings": {"actions": "discrete"}},
    "several numbers": {"id": "Rotor-v0", "angle": "1,2", "settings": {"actions": "several"}},
    "switches": {"id": "Rotor-v0", "settings": {"actions": "binary"}},
    "angle in rad": {"id": "Slider-v0", "angle": "0"},
}


@pytest.fixture(scope="module", autouse=True)
def small():
    environments.register()


def champion_of(robot, controller="recurrent(hidden=4)"):
    n = make_controller(controller).bind_to(make_task(robot.default_task).bind(robot.system)).n_parameters
    parameters = np.random.default_rng(2).standard_normal(n)
    shape = np.zeros((1, 3))
    return Champion(
        "best", parameters, ("a",), "min", 0, shape, controller=controller, task=robot.default_task, system=robot.system
    )


def file_of(champion, tmp_path):
    path = tmp_path / "law.py"
    path.write_text(python_text(exported_controller(champion)))
    return path


@pytest.mark.parametrize("name", ROBOTS)
def test_a_loop_around_the_environment_with_the_file_gives_the_rewards_of_the_robot(name, tmp_path):
    robot = GymnasiumRobot(**ROBOTS[name])
    champion, task = champion_of(robot), make_task(robot.default_task)
    run = robot.runner().bind(make_controller(champion.controller), task)
    seed = trial_seeds(3, 1)
    (trial,) = run(champion.parameters[None], seed, record=True).trajectories
    env = gymnasium.make(ROBOTS[name]["id"], disable_env_checker=True, **ROBOTS[name].get("settings", {}))
    controller = runpy.run_path(str(file_of(champion, tmp_path)))["Controller"]()
    observation, _ = env.reset(seed=int(seed[0]) % 2**31)
    rewards = []
    for _ in range(min(len(trial), 30)):
        action = controller(observation)
        if not isinstance(env.action_space, gymnasium.spaces.Box):
            assert env.action_space.contains(action)
        observation, reward, terminated, truncated, _ = env.step(action)
        rewards.append(reward)
        if terminated or truncated:
            break
    np.testing.assert_allclose(rewards, trial.rewards[: len(rewards)], atol=2e-3)


@pytest.mark.parametrize("name", ["cos and sin", "levels", "several numbers"])
def test_the_file_passes_its_own_check_and_says_that_its_observation_is_raw(name, tmp_path, capsys):
    robot = GymnasiumRobot(**ROBOTS[name])
    path = file_of(champion_of(robot), tmp_path)
    runpy.run_path(str(path), run_name="__main__")
    assert capsys.readouterr().out == "ok: 20 samples\n"
    assert "Raw observation of the environment in, its raw action out." in path.read_text()
    assert "env.step(controller(observation))" in path.read_text()


def test_the_file_in_c_takes_the_raw_observation_too():
    law = exported_controller(champion_of(GymnasiumRobot(id="Pendulum-v1")))
    assert [channel.name for channel in law.observations] == ["observation_0", "observation_1", "observation_2"]
    assert "observation[3]" in c_text(law)


def test_a_learned_reward_is_not_in_the_head_of_the_file(tmp_path):
    robot = GymnasiumRobot(id="Rotor-v0")
    data = robot.record(seed=0, duration=1000 * robot.system.dt).dataset
    champion = champion_of(robot)
    learned = Champion(**{**vars(champion), "task": learn_task(champion.task, data)})
    text = python_text(exported_controller(learned))
    assert "learned='...'" in text
    assert max(map(len, text.splitlines())) < 2000
