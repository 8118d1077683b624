"""Models, ensembles and emulated robots as environments: the same trials as in a rollout."""

from __future__ import annotations

import subprocess
import sys
import warnings
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env

from sysid_evo.controllers import RecurrentNetwork, View
from sysid_evo.engine import rollout
from sysid_evo.environments import ENVIRONMENTS, make_env, make_vector_env, members_of
from sysid_evo.errors import IncompatibleSystem, InvalidArgument
from sysid_evo.models import save_model
from sysid_evo.models.base import make_model
from sysid_evo.registry import make_robot
from sysid_evo.tasks import PointToPoint
from sysid_evo.testing import ExampleDynamics, example_dataset
from sysid_evo.testing.examples import continuous_car, pendulum, switched_car

TASK = "point_to_point(horizon=40, arena_radius=0.4)"


def linear():
    return make_model("linear").fit(example_dataset())


def ensemble():
    return {"linear": linear(), "neighbours": make_model("k_neighbours").fit(example_dataset(seed=4))}


def checked(env):
    """Raise what Gymnasium's checker finds, but for its remark that observations have no limits."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*infinity. This is probably too.*")
        warnings.filterwarnings("ignore", message=".*due to the environment not having a spec.*")
        check_env(env)


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_every_registered_environment_passes_the_checker_of_gymnasium(name):
    checked(gymnasium.make(name).unwrapped)


@pytest.mark.parametrize("actions", ["auto", "continuous"])
def test_a_model_and_an_ensemble_pass_the_checker_of_gymnasium(actions):
    checked(make_env(linear(), TASK, actions=actions, seed=1))
    checked(make_env(ensemble(), TASK, actions=actions, seed=1))


@pytest.mark.parametrize("action", [9, -1, 0.5, [0, 1]])
def test_an_action_that_is_none_of_its_space_is_refused_with_the_space(action):
    env = make_env("pendulum", "swing_up(horizon=20)", actions="continuous")
    with pytest.raises(ResetNeeded, match="call reset"):
        env.step(env.action_space.sample())
    model, several = make_env(linear(), TASK, seed=1), make_vector_env(linear(), TASK, num_envs=2, seed=1)
    with pytest.raises(ResetNeeded, match="call reset"):
        several.step(several.action_space.sample())
    model.reset()
    several.reset()
    with pytest.raises(InvalidArgument, match=r"environment: expected an action of (MultiDiscrete|Box)"):
        model.step([action, 0] if np.isscalar(action) else [*action, 0])
    with pytest.raises(InvalidArgument, match=r"environment: expected an action of"):
        several.step([[action, 0]] * 2 if np.isscalar(action) else action)


def test_a_folder_of_recordings_is_no_ensemble(tmp_path):
    example_dataset().save(tmp_path / "car")
    with pytest.raises(InvalidArgument, match="no model is stored in"):
        make_env(tmp_path / "car", TASK)


def driven(env, parameters):
    """Return the rewards of one episode in which a network drives, with what it is shown in full precision."""
    task = env.trials.task
    controller = RecurrentNetwork(hidden=4).bind(len(task.observations), env.trials.system.nu)
    memory, total, over = np.zeros((1, 1, 4)), 0.0, False
    while not over:
        view = View(env.trials.observe()[None], env.trials.state[None], None)  # type: ignore[arg-type]  # not looked at
        raw, memory = controller.act(parameters[None], memory, view)
        _, reward, ended, late, _ = env.step(raw[0, 0])
        total, over = total + reward, ended or late
    return total


@pytest.mark.parametrize("source", ["emulated_car", "ensemble"])
def test_the_rewards_of_an_episode_are_the_fitness_of_a_rollout_with_its_seed(source):
    members = ensemble() if source == "ensemble" else {source: make_robot(source).dynamics}
    env = make_env(members, TASK, actions="continuous", seed=2)
    parameters = np.random.default_rng(3).standard_normal((6, 4 * (5 + 4 + 2)))
    for candidate in parameters:
        env.reset()
        seeds, name = env.trials.seeds.copy(), env.trials.names[env.trials.member[0]]
        task = PointToPoint(horizon=40, arena_radius=0.4)
        found = rollout(members[name], RecurrentNetwork(hidden=4), candidate[None], task, seeds, engine="reference")
        assert driven(env, candidate) == found.fitness[0, 0]
        assert env.trials.survived[0] == found.survived[0, 0]


def test_number_i_of_a_vector_environment_does_what_a_single_one_does():
    vector = make_vector_env(ensemble(), "point_to_point(horizon=9)", num_envs=3, actions="continuous")
    singles = [make_env(ensemble(), "point_to_point(horizon=9)", actions="continuous") for _ in range(3)]
    shown, _ = vector.reset(seed=7)
    own = [single.reset(seed=7 + i)[0] for i, single in enumerate(singles)]
    np.testing.assert_array_equal(shown, own)
    rng, ended, met = np.random.default_rng(0), [False] * 3, set()
    for _ in range(25):
        actions = rng.uniform(-1.0, 1.0, (3, 2))
        shown, reward, over, late, info = vector.step(actions)
        met |= set(vector.trials.member.tolist())
        for i, single in enumerate(singles):
            if ended[i]:
                expected: Any = (single.reset()[0], 0.0, False, False)
            else:
                expected = single.step(actions[i])[:4]
            ended[i] = expected[2] or expected[3]
            np.testing.assert_array_equal(shown[i], expected[0])
            assert (reward[i], over[i], late[i]) == expected[1:]
            assert info["fitness"][i] == single.trials.fitness[0]
    assert met == {0, 1}


def test_an_episode_of_an_ensemble_is_on_a_member_drawn_from_the_seed():
    env = make_env(ensemble(), TASK)
    members = [env.reset(seed=seed)[1]["member"] for seed in range(12)]
    assert set(members) == {"linear", "neighbours"}
    assert members == [env.reset(seed=seed)[1]["member"] for seed in range(12)]
    assert env.reset(options={"member": "linear"})[1]["member"] == "linear"
    with pytest.raises(InvalidArgument, match="no member is called 'x': linear, neighbours"):
        env.reset(options={"member": "x"})


def test_the_seed_of_the_environment_is_that_of_its_first_episode_only():
    first, second = make_env(linear(), TASK, seed=5), make_env(linear(), TASK)
    np.testing.assert_array_equal(first.reset()[0], second.reset(seed=5)[0])
    before = first.trials.seeds.copy()
    first.reset()
    assert first.trials.seeds != before


def test_discrete_actions_are_the_numbers_of_levels_and_continuous_ones_a_controllers_outputs():
    env = make_env(ExampleDynamics(switched_car()), TASK)
    assert env.action_space == spaces.MultiDiscrete([3, 3])
    env.reset(seed=0)
    after = env.step(np.array([2, 0]))[4]["state"]
    free = make_env(ExampleDynamics(switched_car()), TASK, actions="continuous")
    free.reset(seed=0)
    np.testing.assert_array_equal(free.step(np.array([0.8, -0.8]))[4]["state"], after)
    assert isinstance(make_env(ExampleDynamics(continuous_car()), TASK).action_space, spaces.Box)
    with pytest.raises(InvalidArgument, match="control 'drive' has no levels"):
        make_env(ExampleDynamics(continuous_car()), TASK, actions="discrete")


class Exploding(ExampleDynamics):
    def step(self, carry, control, noise=None):
        return np.where(np.abs(carry) > 0.1, np.nan, super().step(carry, control, noise))


def test_a_trial_that_diverges_is_terminated_and_worth_less_than_any_other():
    env = make_env(Exploding(switched_car()), TASK, actions="continuous")
    env.reset(seed=0)
    total, steps, over = 0.0, 0, False
    while not over:
        shown, reward, over, late, info = env.step(np.array([1.0, 1.0]))
        total, steps = total + reward, steps + 1
        assert np.isfinite(shown).all()
    assert not late
    assert info["fitness"] == -1.0 + (steps - 1) / 40
    assert total == pytest.approx(info["fitness"])


def test_an_environment_is_truncated_at_the_horizon_of_its_task():
    env = make_env(linear(), "point_to_point(horizon=7)", actions="continuous")
    env.reset(seed=0)
    ends = [env.step(np.zeros(2))[2:4] for _ in range(7)]
    assert ends == [(False, False)] * 6 + [(False, True)]


def test_units_and_names_stand_in_the_metadata():
    metadata = make_env("emulated_car").metadata
    assert metadata["observations"]["waypoint_distance"] == "m"
    assert metadata["reward"] == "waypoints"
    assert (metadata["dt"], metadata["render_fps"]) == (0.05, 20)


def test_models_are_found_by_path_by_folder_and_as_several(tmp_path):
    for name, model in ensemble().items():
        save_model(model, tmp_path / name)
    assert set(members_of(tmp_path)) == {"linear", "neighbours"}
    assert set(members_of(tmp_path / "linear.json")) == {"linear"}
    assert set(members_of([tmp_path / "linear.json", linear()])) == {"linear-1", "Linear-2"}
    with pytest.raises(InvalidArgument, match="no model is stored in"):
        members_of(tmp_path.parent / tmp_path.name / "..")
    with pytest.raises(InvalidArgument, match="is no emulated robot"):
        members_of("serial")


def test_models_of_different_systems_are_no_ensemble():
    with pytest.raises(IncompatibleSystem, match="car and swing differ"):
        make_env({"car": ExampleDynamics(switched_car()), "swing": ExampleDynamics(pendulum())}, TASK)


def test_a_render_mode_is_refused_with_another_way_to_look():
    for make in (gymnasium.make, gymnasium.make_vec):
        with pytest.raises(InvalidArgument, match=r"expected no render_mode.*got 'rgb_array'.*--watch"):
            make("sysid_evo/SwingUp-v0", render_mode="rgb_array")


def test_nothing_else_imports_gymnasium():
    program = "import sys, sysid_evo.cli.app, evaluation, sysid_evo.engine; sys.exit('gymnasium' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


def test_without_gymnasium_it_is_said_what_is_missing():
    program = "import sys; sys.modules['gymnasium'] = None; import sysid_evo; sysid_evo.make_env"
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert "MissingExtra: an environment needs the package 'gymnasium', which is not installed." in ended.stderr
