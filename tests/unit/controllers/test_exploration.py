"""Noise on the commands of a controller, under which a robot is recorded."""

import numpy as np
import pytest

from sysid_evo.controllers.controller import View, make_controller
from sysid_evo.controllers.linear import Exploring
from sysid_evo.engine import rollout
from sysid_evo.errors import InvalidArgument
from sysid_evo.models.base import make_model
from sysid_evo.randomness import trial_seeds
from sysid_evo.system import Channel, System
from sysid_evo.tasks.task import make_task
from sysid_evo.testing.examples import example_dataset

SYSTEM = System(
    (Channel("speed", "m/s"),), (Channel("force", "N", -2.0, 2.0), Channel("gear", levels=(-1.0, 0.0, 1.0))), 0.1
)


def acted(noise, trials=4000):
    """Return the commands (trials, 2) of constant controls with noise, in units of half their range."""
    task = make_task("set_point(channels=speed)").bind(SYSTEM)
    law = Exploring(make_controller("constant"), noise).bind_to(task)
    z = np.random.default_rng(0).standard_normal((1, trials, law.n_noise))
    seen = np.zeros((1, trials, len(task.observations)))
    view = View(seen, np.zeros((1, trials, 1)), task.begin(trial_seeds(0, trials)), z)
    raw, _ = law.act(np.array([[0.2, 0.0]]), np.zeros((1, trials, 0)), view)
    return raw[0]


def test_a_continuous_command_gets_noise_and_one_with_levels_is_sometimes_replaced():
    force, gear = acted(0.2).T
    assert force.std() == pytest.approx(0.2, rel=0.05)
    assert force.mean() == pytest.approx(0.2, abs=0.02)
    assert (gear != 0.0).mean() == pytest.approx(0.2, abs=0.02)
    replaced = gear[gear != 0.0]
    assert replaced.std() == pytest.approx(np.sqrt(1.0 / 3.0), rel=0.05)  # uniform over the range
    assert np.abs(acted(1.0)).max() <= 1.0


def test_without_noise_the_commands_are_those_of_the_controller():
    np.testing.assert_array_equal(acted(0.0, 3), np.tile([0.2, 0.0], (3, 1)))


def test_candidates_meet_the_same_noise_and_trials_different_noise():
    data = example_dataset()
    model = make_model("linear").fit(data, rng=np.random.default_rng(0))
    task = make_task("set_point(horizon=20)") if data.system.motion is None else make_task("point_to_point(horizon=20)")
    law = Exploring(make_controller("linear"), 0.3)
    n = law.bind_to(task.bind(data.system)).n_parameters
    made = rollout(model, law, np.zeros((2, n)), task, trial_seeds(1, 2), record=True)
    one, other, again, _ = (run.controls for run in made.trajectories)
    np.testing.assert_array_equal(one, again)
    assert not np.array_equal(one, other)


@pytest.mark.parametrize("noise", [-0.1, 1.5])
def test_noise_is_a_share(noise):
    with pytest.raises(InvalidArgument, match="command noise: expected a number from 0 to 1"):
        Exploring(make_controller("linear"), noise)
