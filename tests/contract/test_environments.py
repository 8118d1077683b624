"""Models, ensembles and emulated robots as environments of Gymnasium; policies that learned in them as champions."""

import importlib
import subprocess
import sys
import warnings

import numpy as np
import pytest

from evaluation.transfer.matrix import transfer
from sysid_evo.controllers import RecurrentNetwork, View
from sysid_evo.controllers.controller import make_controller
from sysid_evo.engine import DynamicsRunner, rollout
from sysid_evo.errors import IncompatibleSystem, InvalidArgument
from sysid_evo.evolution.champion import load_champion, save_champion
from sysid_evo.models import save_model
from sysid_evo.models.base import make_model
from sysid_evo.registry import make_robot
from sysid_evo.tasks import PointToPoint
from sysid_evo.testing import ExampleDynamics, example_dataset
from sysid_evo.testing.examples import continuous_car, pendulum, switched_car

TASK = "point_to_point(horizon=40, arena_radius=0.4)"
SHORT = "point_to_point(horizon=9)"


@pytest.fixture(scope="module")
def envs():
    """The package of environments, which imports Gymnasium."""
    return importlib.import_module("sysid_evo.environments")


@pytest.fixture(scope="module")
def linear():
    return make_model("linear").fit(example_dataset())


@pytest.fixture(scope="module")
def ensemble(linear):
    return {"linear": linear, "neighbours": make_model("k_neighbours").fit(example_dataset(seed=4))}


@pytest.fixture(scope="module")
def learned(envs):
    """A function that returns an algorithm of Stable-Baselines3, which has not learned yet, and its environment."""
    algorithms = importlib.import_module("stable_baselines3")

    def learned(algorithm, **settings):
        env = envs.make_env(made_up(), TASK, actions="continuous", seed=1)
        return getattr(algorithms, algorithm)("MlpPolicy", env, seed=0, device="cpu", **settings), env

    return learned


def made_up():
    return {"made_up": ExampleDynamics(continuous_car())}


def checked(env):
    """Raise what Gymnasium's checker finds, but for its remark that observations have no limits."""
    from gymnasium.utils.env_checker import check_env

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*infinity. This is probably too.*")
        warnings.filterwarnings("ignore", message=".*due to the environment not having a spec.*")
        check_env(env)


def test_every_registered_environment_passes_the_checker_of_gymnasium(envs):
    import gymnasium

    assert envs.ENVIRONMENTS
    for name in envs.ENVIRONMENTS:
        checked(gymnasium.make(name).unwrapped)


@pytest.mark.parametrize("actions", ["auto", "continuous"])
def test_a_model_and_an_ensemble_pass_the_checker_of_gymnasium(actions, envs, linear, ensemble):
    for source in (linear, ensemble):
        checked(envs.make_env(source, TASK, actions=actions, seed=1))


def test_a_step_before_the_first_reset_is_refused(envs, linear):
    from gymnasium.error import ResetNeeded

    for env in (
        envs.make_env("pendulum", "swing_up(horizon=20)", actions="continuous"),
        envs.make_vector_env(linear, TASK, num_envs=2, seed=1),
    ):
        with pytest.raises(ResetNeeded, match="call reset"):
            env.step(env.action_space.sample())


@pytest.mark.parametrize("action", [9, -1, 0.5, [0, 1]])
def test_an_action_that_is_none_of_its_space_is_refused_with_the_space(action, envs, linear):
    model, several = envs.make_env(linear, TASK, seed=1), envs.make_vector_env(linear, TASK, num_envs=2, seed=1)
    model.reset()
    several.reset()
    with pytest.raises(InvalidArgument, match=r"environment: expected an action of (MultiDiscrete|Box)"):
        model.step([action, 0] if np.isscalar(action) else [*action, 0])
    with pytest.raises(InvalidArgument, match=r"environment: expected an action of"):
        several.step([[action, 0]] * 2 if np.isscalar(action) else action)


def driven(env, parameters):
    """Return the rewards of one episode in which a network drives, with what it is shown in full precision."""
    controller = RecurrentNetwork(hidden=4).bind(len(env.trials.task.observations), env.trials.system.nu)
    memory, total, over = np.zeros((1, 1, 4)), 0.0, False
    while not over:
        view = View(env.trials.observe()[None], env.trials.state[None], None)
        raw, memory = controller.act(parameters[None], memory, view)
        _, reward, ended, late, _ = env.step(raw[0, 0])
        total, over = total + reward, ended or late
    return total


@pytest.mark.parametrize("source", ["emulated_car", "ensemble"])
def test_the_rewards_of_an_episode_are_the_fitness_of_a_rollout_with_its_seed(source, envs, ensemble):
    members = ensemble if source == "ensemble" else {source: make_robot(source).dynamics}
    env = envs.make_env(members, TASK, actions="continuous", seed=2)
    for candidate in np.random.default_rng(3).standard_normal((6, 4 * (5 + 4 + 2))):
        env.reset()
        seeds, name = env.trials.seeds.copy(), env.trials.names[env.trials.member[0]]
        task = PointToPoint(horizon=40, arena_radius=0.4)
        found = rollout(members[name], RecurrentNetwork(hidden=4), candidate[None], task, seeds, engine="reference")
        assert driven(env, candidate) == found.fitness[0, 0]
        assert env.trials.survived[0] == found.survived[0, 0]


def test_number_i_of_a_vector_environment_does_what_a_single_one_does(envs, ensemble):
    vector = envs.make_vector_env(ensemble, SHORT, num_envs=3, actions="continuous")
    singles = [envs.make_env(ensemble, SHORT, actions="continuous") for _ in range(3)]
    shown, _ = vector.reset(seed=7)
    np.testing.assert_array_equal(shown, [single.reset(seed=7 + i)[0] for i, single in enumerate(singles)])
    rng, ended, met = np.random.default_rng(0), [False] * 3, set()
    for _ in range(25):
        actions = rng.uniform(-1.0, 1.0, (3, 2))
        shown, reward, over, late, info = vector.step(actions)
        met |= set(vector.trials.member.tolist())
        for i, single in enumerate(singles):
            expected = (single.reset()[0], 0.0, False, False) if ended[i] else single.step(actions[i])[:4]
            ended[i] = expected[2] or expected[3]
            np.testing.assert_array_equal(shown[i], expected[0])
            assert (reward[i], over[i], late[i]) == expected[1:]
            assert info["fitness"][i] == single.trials.fitness[0]
    assert met == {0, 1}


def test_an_episode_of_an_ensemble_is_on_a_member_drawn_from_the_seed(envs, ensemble):
    env = envs.make_env(ensemble, TASK)
    members = [env.reset(seed=seed)[1]["member"] for seed in range(12)]
    assert set(members) == {"linear", "neighbours"}
    assert members == [env.reset(seed=seed)[1]["member"] for seed in range(12)]
    assert env.reset(options={"member": "linear"})[1]["member"] == "linear"
    with pytest.raises(InvalidArgument, match="expected a member among linear, neighbours, got 'x'"):
        env.reset(options={"member": "x"})


def test_the_seed_of_the_environment_is_that_of_its_first_episode_only(envs, linear):
    first, second = envs.make_env(linear, TASK, seed=5), envs.make_env(linear, TASK)
    np.testing.assert_array_equal(first.reset()[0], second.reset(seed=5)[0])
    before = first.trials.seeds.copy()
    first.reset()
    assert first.trials.seeds != before


def test_discrete_actions_are_the_numbers_of_levels_and_continuous_ones_a_controllers_outputs(envs):
    from gymnasium import spaces

    env = envs.make_env(ExampleDynamics(switched_car()), TASK)
    assert env.action_space == spaces.MultiDiscrete([3, 3])
    env.reset(seed=0)
    after = env.step(np.array([2, 0]))[4]["state"]
    free = envs.make_env(ExampleDynamics(switched_car()), TASK, actions="continuous")
    free.reset(seed=0)
    np.testing.assert_array_equal(free.step(np.array([0.8, -0.8]))[4]["state"], after)
    assert isinstance(envs.make_env(made_up(), TASK).action_space, spaces.Box)
    with pytest.raises(InvalidArgument, match="control 'drive' has no levels"):
        envs.make_env(made_up(), TASK, actions="discrete")


class Exploding(ExampleDynamics):
    def step(self, carry, control, noise=None):
        return np.where(np.abs(carry) > 0.1, np.nan, super().step(carry, control, noise))


def test_a_trial_that_diverges_is_terminated_and_worth_less_than_any_other(envs):
    env = envs.make_env(Exploding(switched_car()), TASK, actions="continuous")
    env.reset(seed=0)
    total, steps, over = 0.0, 0, False
    while not over:
        shown, reward, over, late, info = env.step(np.array([1.0, 1.0]))
        total, steps = total + reward, steps + 1
        assert np.isfinite(shown).all()
    assert not late
    assert info["fitness"] == -1.0 + (steps - 1) / 40
    assert total == pytest.approx(info["fitness"])


def test_an_environment_is_truncated_at_the_horizon_of_its_task(envs, linear):
    env = envs.make_env(linear, "point_to_point(horizon=7)", actions="continuous")
    env.reset(seed=0)
    assert [env.step(np.zeros(2))[2:4] for _ in range(7)] == [(False, False)] * 6 + [(False, True)]


def test_units_and_names_are_in_the_metadata(envs):
    metadata = envs.make_env("emulated_car").metadata
    assert metadata["observations"]["waypoint_distance"] == "m"
    assert metadata["reward"] == "waypoints"
    assert (metadata["dt"], metadata["render_fps"]) == (0.05, 20)


def test_models_are_found_by_path_by_folder_and_as_several(envs, ensemble, linear, stored_data, tmp_path):
    for name, model in ensemble.items():
        save_model(model, tmp_path / name)
    assert set(envs.load_members(tmp_path)) == {"linear", "neighbours"}
    assert set(envs.load_members(tmp_path / "linear.json")) == {"linear"}
    assert set(envs.load_members([tmp_path / "linear.json", linear])) == {"linear-1", "Linear-2"}
    for folder in (tmp_path / "..", stored_data):
        with pytest.raises(InvalidArgument, match="no model is stored in"):
            envs.load_members(folder)
    with pytest.raises(InvalidArgument, match="is not an emulated robot"):
        envs.load_members("serial")
    with pytest.raises(IncompatibleSystem, match="car and swing differ"):
        envs.make_env({"car": ExampleDynamics(switched_car()), "swing": ExampleDynamics(pendulum())}, TASK)


def test_a_render_mode_is_refused_with_another_way_to_look(envs):
    import gymnasium

    for make in (gymnasium.make, gymnasium.make_vec):
        with pytest.raises(InvalidArgument, match=r"expected no render_mode.*got 'rgb_array'.*--watch"):
            make("sysid_evo/SwingUp-v0", render_mode="rgb_array")


def test_nothing_else_needs_gymnasium_and_without_it_the_error_names_the_package():
    program = (
        "import sys; sys.modules['gymnasium'] = None; import sysid_evo.cli.app, evaluation, sysid_evo.engine; "
        "print('imported'); sysid_evo.make_env"
    )
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert ended.stdout == "imported\n"
    assert "MissingExtra: an environment needs the package 'gymnasium', which is not installed." in ended.stderr


@pytest.mark.parametrize("algorithm", ["PPO", "SAC"])
def test_a_policy_as_a_controller_acts_as_the_policy_itself(algorithm, envs, learned):
    model, env = learned(algorithm)
    champion = envs.champion_from_policy(model, env.trials, name="peer", task=TASK)
    controller = make_controller(champion.controller).bind(5, 2)
    observation = np.random.default_rng(0).standard_normal((1, 30, 5)).astype(np.float32)
    view = View(observation.astype(np.float64), np.zeros((1, 30, 3)), None)
    raw, _ = controller.act(champion.parameters[None], np.zeros((1, 30, 0)), view)
    np.testing.assert_allclose(raw[0], model.predict(observation[0], deterministic=True)[0], atol=1e-5)


def test_a_policy_is_in_the_transfer_matrix_and_is_stored_without_pickle(envs, learned, tmp_path):
    model, env = learned("PPO", n_steps=32, batch_size=32)
    model.learn(32)
    champion = envs.champion_from_policy(model, env.trials, name="ppo", task=TASK)
    save_champion(champion, tmp_path / "ppo")
    again = load_champion(tmp_path / "ppo")
    runner = DynamicsRunner(ExampleDynamics(continuous_car()))
    matrix = transfer([again], {"made_up": runner, "other": runner}, seed=0, trials=3)
    cells = [matrix.cell("ppo", column) for column in ("made_up", "other")]
    assert all(not cell.failed and len(cell.fitness) == 3 for cell in cells)
    np.testing.assert_array_equal(again.parameters, champion.parameters)


def test_what_is_no_plain_policy_with_continuous_actions_is_refused(envs):
    from stable_baselines3 import DQN, PPO

    env = envs.make_env("emulated_car", TASK)
    with pytest.raises(InvalidArgument, match="make the environment with actions='continuous'"):
        envs.champion_from_policy(PPO("MlpPolicy", env, device="cpu"), env.trials, name="x", task=TASK)
    cart = envs.make_env("emulated_car", TASK, actions="continuous")
    with pytest.raises(InvalidArgument, match="expected the MlpPolicy of PPO or SAC"):
        envs.champion_from_policy(type("Odd", (), {"policy": DQN})(), cart.trials, name="x", task=TASK)


def test_a_vector_environment_is_to_stable_baselines_what_single_ones_are(envs):
    from stable_baselines3.common.vec_env import DummyVecEnv

    from sysid_evo.environments.stable_baselines import StableBaselinesEnv

    source = {**made_up(), "again": ExampleDynamics(continuous_car())}
    vector = StableBaselinesEnv(envs.make_vector_env(source, SHORT, num_envs=3, actions="continuous"))
    singles = DummyVecEnv([lambda: envs.make_env(source, SHORT, actions="continuous")] * 3)
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


def test_an_algorithm_learns_in_a_vector_environment(envs):
    from stable_baselines3 import PPO

    from sysid_evo.environments.stable_baselines import StableBaselinesEnv

    many = StableBaselinesEnv(envs.make_vector_env(made_up(), SHORT, num_envs=4, actions="continuous"))
    learner = PPO("MlpPolicy", many, n_steps=32, batch_size=32, seed=0, device="cpu").learn(128)
    assert learner.num_timesteps == 128
    assert len(learner.ep_info_buffer) > 0
    assert envs.champion_from_policy(learner, many.env.trials, name="ppo", task=SHORT).against == ("made_up",)
