"""A reward of one function by the names of states and controls: computed, compiled, named, refused."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest

from sysid_evo import register_reward
from sysid_evo.errors import IncompatibleTask, InvalidArgument
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import tasks
from sysid_evo.tasks.task import make_task
from sysid_evo.testing import check_task
from sysid_evo.testing.examples import pendulum, switched_car
from tests.fixtures.commands import run_here

NAMES = ("swung", "swung_in_python", "braked", "rooted", "odd")


def worth(torque, angle, weight=0.5):
    """The angle up, with little torque."""
    return -math.cos(angle) - weight * torque**2


def fast(angular_speed):
    return abs(angular_speed) > 2.5


def braked(forward_speed, steer, drive):
    return forward_speed - 0.1 * steer * drive


def rooted(angle):
    return math.sqrt(angle) + 1.0 / angle


@pytest.fixture(autouse=True)
def registered():
    start = {"angle": (-1.0, 1.0), "angular_speed": (0.0, 2.0)}
    register_reward("swung", lowest=-2.0, horizon=60, ended=fast, start=start)(worth)
    register_reward("swung_in_python", lowest=-2.0, horizon=60, ended=fast, start=start, compiled=False)(worth)
    register_reward("braked", lowest=-2.0, horizon=40)(braked)
    register_reward("rooted", lowest=-3.0, horizon=1)(rooted)
    yield
    for name in NAMES:
        tasks.forget(name)


def test_arguments_are_taken_by_name_and_those_with_a_default_are_parameters():
    states, controls = np.array([[0.3, 9.0], [2.0, -9.0]]), np.array([[1.0], [-2.0]])
    for weight in (0.5, 0.1):
        task = make_task(f"swung(weight={weight})" if weight != 0.5 else "swung").bind(pendulum())
        np.testing.assert_allclose(task.worth(states, controls), -np.cos(states[:, 0]) - weight * controls[:, 0] ** 2)
    with pytest.raises(InvalidArgument, match=r"no parameter 'wight'. Did you mean 'weight'\?"):
        make_task("swung(wight=1)")
    with pytest.raises(InvalidArgument, match="weight: expected a finite number, got 'much'"):
        make_task("swung(weight=much)")


@pytest.mark.parametrize(
    ("name", "system"), [("swung", pendulum()), ("swung_in_python", pendulum()), ("braked", switched_car())]
)
def test_the_contract_is_kept_and_the_compiled_form_is_the_reference(name, system):
    check_task(name, system)
    assert (make_task(name).bind(system).kernel() is None) == (name == "swung_in_python")


def test_a_trial_begins_between_the_two_values_and_is_over_where_ended_says():
    task = make_task("swung").bind(pendulum())
    trials: Any = task.begin(trial_seeds(1, 50))
    assert np.all(np.abs(trials.state[:, 0]) <= 1.0)
    assert trials.state[:, 1].min() < 0.4 < 1.6 < trials.state[:, 1].max() <= 2.0
    after = np.array([[0.0, 2.4], [0.0, -2.6]])
    state: Any = task.begin(trial_seeds(1, 2))
    moved, _ = task.advance(state, state.state, after, control=np.zeros((2, 1)))
    assert moved.alive.tolist() == [True, False]


def test_what_cannot_be_computed_counts_as_the_lowest():
    task = make_task("rooted").bind(pendulum())
    np.testing.assert_array_equal(
        np.isnan(task.worth(np.array([[-1.0, 0.0], [0.0, 0.0], [1.0, 0.0]]), np.zeros((3, 1)))), [True, True, False]
    )
    before = np.array([[-1.0, 0.0]])
    trial, _ = task.advance(task.begin(trial_seeds(1, 1)), before, before, control=np.zeros((1, 1)))
    assert task.fitness(trial)[0] == -3.0


def test_what_a_system_lacks_is_named_and_odd_arguments_are_refused():
    with pytest.raises(IncompatibleTask, match=r"swung needs 'torque' as a state, a control or .*forward_speed"):
        make_task("swung").bind(switched_car())
    register_reward("odd", lowest=0.0, start={"torque": (0.0, 1.0)})(rooted)
    with pytest.raises(IncompatibleTask, match="odd needs 'torque' as a state; states: angle, angular_speed"):
        make_task("odd").bind(pendulum())
    with pytest.raises(InvalidArgument, match="each by its name, and none called horizon; got states"):
        register_reward("wrong", lowest=0.0)(lambda *states: 0.0)
    with pytest.raises(InvalidArgument, match="got horizon"):
        register_reward("wrong", lowest=0.0)(lambda horizon: 0.0)


def test_in_a_file_of_its_own_it_has_a_name_on_the_command_line(tmp_path):
    (tmp_path / "warm.py").write_text(
        "from sysid_evo import register_reward\n\n\n"
        '@register_reward("warm", lowest=-100.0)\n'
        "def warm(temperature, heater, wanted=50.0):\n"
        '    """As warm as is wanted, and little heating."""\n'
        "    return -abs(temperature - wanted) - heater\n"
    )
    listed = run_here("names", "task", "--plugin", "warm.py", "--json", cwd=tmp_path)
    (row,) = [row for row in json.loads(listed.stdout) if row["name"] == "warm"]
    assert row["summary"] == "As warm as is wanted, and little heating."
    assert row["parameters"] == "horizon=300, wanted=50.0"
    done = run_here(
        "evolve", "--plugin", "warm.py", "--against", "thermal", "--task", "warm(wanted=40, horizon=20)",
        "--controller", "linear", "--generations", "2", "--trials", "2", "--strategy", "mu_plus_lambda(children=5)",
        "--run", ".", cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
