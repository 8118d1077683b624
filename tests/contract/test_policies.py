"""A policy of Stable-Baselines3 as a champion: it acts as the policy does, and stands in the transfer matrix."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from stable_baselines3 import DQN, PPO, SAC
from stable_baselines3.common.vec_env import DummyVecEnv

from evaluation.transfer import transfer
from sysid_evo.controllers import View
from sysid_evo.controllers.controller import make_controller
from sysid_evo.engine import DynamicsRunner
from sysid_evo.environments import champion_of, make_env, make_vector_env
from sysid_evo.environments.stable_baselines import StableBaselinesEnv
from sysid_evo.errors import InvalidArgument
from sysid_evo.evolution.champion import load_champion, save_champion
from sysid_evo.testing import ExampleDynamics
from sysid_evo.testing.examples import continuous_car

TASK = "point_to_point(horizon=20, arena_radius=0.4)"


def learned(algorithm, **settings):
    env = make_env({"made_up": ExampleDynamics(continuous_car())}, TASK, actions="continuous", seed=1)
    return algorithm("MlpPolicy", env, seed=0, device="cpu", **settings), env


@pytest.mark.parametrize("algorithm", [PPO, SAC])
def test_a_policy_as_a_controller_acts_as_the_policy_itself(algorithm):
    model, env = learned(algorithm)
    champion = champion_of(model, env.trials, name="peer", task=TASK)
    controller = make_controller(champion.controller).bind(5, 2)
    observation = np.random.default_rng(0).standard_normal((1, 30, 5)).astype(np.float32)
    view = View(observation.astype(np.float64), np.zeros((1, 30, 3)), None)  # type: ignore[arg-type]  # not looked at
    raw, _ = controller.act(champion.parameters[None], np.zeros((1, 30, 0)), view)
    np.testing.assert_allclose(raw[0], model.predict(observation[0], deterministic=True)[0], atol=1e-5)


def test_a_policy_stands_in_the_transfer_matrix_and_is_stored_without_pickle(tmp_path):
    model, env = learned(PPO, n_steps=32, batch_size=32)
    model.learn(32)
    champion = champion_of(model, env.trials, name="ppo", task=TASK)
    save_champion(champion, tmp_path / "ppo")
    again = load_champion(tmp_path / "ppo")
    runner = DynamicsRunner(ExampleDynamics(continuous_car()))
    matrix = transfer([again], {"made_up": runner, "other": runner}, seed=0, trials=3)
    cells = [matrix.cell("ppo", column) for column in ("made_up", "other")]
    assert all(not cell.failed and len(cell.fitness) == 3 for cell in cells)
    np.testing.assert_array_equal(again.parameters, champion.parameters)


def test_what_is_no_plain_policy_with_continuous_actions_is_refused():
    env = make_env("emulated_car", TASK)
    with pytest.raises(InvalidArgument, match="make the environment with actions='continuous'"):
        champion_of(PPO("MlpPolicy", env, device="cpu"), env.trials, name="x", task=TASK)
    cart = make_env("emulated_car", TASK, actions="continuous")
    with pytest.raises(InvalidArgument, match="expected the MlpPolicy of PPO or SAC"):
        champion_of(type("Odd", (), {"policy": DQN})(), cart.trials, name="x", task=TASK)


def test_a_vector_environment_is_to_stable_baselines_what_single_ones_are():
    source: Any = {"made_up": ExampleDynamics(continuous_car()), "again": ExampleDynamics(continuous_car())}
    task = "point_to_point(horizon=9)"
    vector = StableBaselinesEnv(make_vector_env(source, task, num_envs=3, actions="continuous"))
    singles = DummyVecEnv([lambda: make_env(source, task, actions="continuous")] * 3)
    rng = np.random.default_rng(0)
    vector.seed(7), singles.seed(7)
    np.testing.assert_array_equal(vector.reset(), singles.reset())
    for _ in range(25):
        actions = rng.uniform(-1.0, 1.0, (3, 2)).astype(np.float32)
        found, expected = vector.step(actions), singles.step(actions)
        for mine, its in zip(found[:3], expected[:3], strict=True):
            np.testing.assert_array_equal(mine, its)
        for mine, its in zip(found[3], expected[3], strict=True):
            assert mine.get("TimeLimit.truncated", False) == its["TimeLimit.truncated"]
            np.testing.assert_array_equal(mine.get("terminal_observation", 0), its.get("terminal_observation", 0))


def test_an_algorithm_learns_in_a_vector_environment():
    source: Any = {"made_up": ExampleDynamics(continuous_car())}
    many = StableBaselinesEnv(make_vector_env(source, TASK, num_envs=4, actions="continuous"))
    learner = PPO("MlpPolicy", many, n_steps=32, batch_size=32, seed=0, device="cpu").learn(128)
    assert learner.num_timesteps == 128
    assert len(learner.ep_info_buffer) > 0
    assert champion_of(learner, many.env.trials, name="ppo", task=TASK).against == ("made_up",)
