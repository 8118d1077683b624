"""A model inside the controller: what it imagines, what it plans, what it may not know."""

from dataclasses import replace

import numpy as np
import pytest

from sysid_evo import DynamicsRunner, make_controller, make_model
from sysid_evo.controllers import View
from sysid_evo.engine import rollout
from sysid_evo.errors import IncompatibleTask, InvalidArgument
from sysid_evo.models import Dynamics, save_model
from sysid_evo.predictive_control import ImaginedTrials, Predictive
from sysid_evo.randomness import trial_seeds
from sysid_evo.system import Channel, System
from sysid_evo.tasks import PointToPoint
from sysid_evo.testing import example_dataset
from sysid_evo.testing.examples import ExampleDynamics, continuous_car, switched_car


class Steered(Dynamics):
    """A planar body whose speeds follow its controls: x' = x / 2 + controls."""

    def __init__(self, system, n_lags=0):
        self.system, self.n_carry, self.n_lags = system, system.nx, n_lags
        self.started = []

    def start(self, states, controls, draws=None):
        self.started.append((states.copy(), controls.copy()))
        return states[:, -1].copy()

    def step(self, carry, control, noise=None):
        after = 0.5 * carry
        after[:, 0] += 0.6 * control[:, 0]
        after[:, 2] += 2.0 * control[:, 1]
        return after


TASK = PointToPoint(horizon=60)


@pytest.mark.parametrize("system", [switched_car(), continuous_car()])
def test_with_the_robot_itself_inside_it_passes_waypoints_without_evolution(system):
    body = Steered(system)
    planning = Predictive(model=body, samples=24, horizon=12)
    fitness = {
        name: DynamicsRunner(body).bind(law, TASK)(np.zeros((1, n)), trial_seeds(1, 3)).fitness.mean()
        for name, law, n in (("planning", planning, 2), ("nothing", make_controller("linear"), 12))
    }
    assert fitness["planning"] > 1.5
    assert fitness["nothing"] == 0.0


def test_a_seed_makes_it_repeatable_and_trials_are_independent():
    body, law = Steered(switched_car()), Predictive(model=Steered(switched_car()), samples=24, horizon=4)
    task = PointToPoint(horizon=10)
    first, again = (rollout(body, law, np.zeros((1, 2)), task, trial_seeds(1, 3), record=True) for _ in range(2))
    alone = rollout(body, law, np.zeros((1, 2)), task, trial_seeds(1, 1), record=True)
    for run in (again, alone):
        np.testing.assert_array_equal(run.trajectories[0].controls, first.trajectories[0].controls)
    other = rollout(body, Predictive(model=body, samples=24, horizon=4, seed=1), np.zeros((1, 2)), task,
                    trial_seeds(1, 3), record=True)  # fmt: skip
    assert not np.array_equal(other.trajectories[0].controls, first.trajectories[0].controls)


def test_it_imagines_what_a_rollout_would_do():
    system = continuous_car()
    body, task = Steered(system), PointToPoint(horizon=25).bind(system)
    seeds = trial_seeds(3, 4)
    sequences = np.random.default_rng(0).uniform(-1.0, 1.0, (5, 4, 25, 2))
    began = task.begin(seeds)
    scores = ImaginedTrials(body, task).scores(began.state[:, None], np.zeros((4, 0, 2)), sequences, began)
    for k in range(5):
        here, carry = began, began.state
        for step in range(25):
            after = body.step(carry, sequences[k, :, step])
            here, _ = task.advance(here, carry, after, control=sequences[k, :, step])
            carry = after
        np.testing.assert_allclose(scores[k], task.fitness(here) + task.potential(here, carry))


class Exploding(Steered):
    """Diverges where it is driven forward hard."""

    def step(self, carry, control, noise=None):
        return np.where(control[:, :1] > 0.5, np.inf, super().step(carry, control))


def test_the_lowest_score_of_several_models_counts():
    system = continuous_car()
    task = PointToPoint().bind(system)
    state = task.begin(trial_seeds(2, 1))
    ahead = replace(state, waypoints=np.full_like(state.waypoints, 1.0) * [1.0, 0.0])
    view = View(task.observe(ahead, ahead.state)[None], ahead.state[None], ahead)
    alone, both = (
        Predictive(model=model, samples=32, horizon=10).bind_to(task)
        for model in (Steered(system), [Steered(system), Exploding(system)])
    )
    drives = [law.act(np.zeros((1, 2)), np.zeros((1, 1, law.n_memory)), view)[0][0, 0, 0] for law in (alone, both)]
    assert drives[0] > 0.5 >= drives[1]


def test_a_model_with_lags_is_given_the_states_and_controls_before():
    system = continuous_car()
    body = Steered(system, n_lags=2)
    law = Predictive(model=body, samples=16, horizon=3)
    ran = rollout(Steered(system), law, np.zeros((1, 2)), PointToPoint(horizon=5), trial_seeds(1, 1), record=True)
    states, controls = ran.trajectories[0].states, ran.trajectories[0].controls
    first, last = body.started[0], body.started[-1]
    np.testing.assert_allclose(first[0][0], np.tile(states[0], (3, 1)))
    np.testing.assert_array_equal(first[1][0], np.tile(system.neutral_control, (2, 1)))
    np.testing.assert_allclose(last[0][0], states[2:5])
    np.testing.assert_allclose(last[1][0], controls[2:4])


def test_it_does_not_know_the_waypoint_after_the_next():
    system = continuous_car()
    task = PointToPoint().bind(system)
    state = task.begin(trial_seeds(2, 3))
    moved = state.waypoints.copy()
    moved[:, 1:] += 1.0
    known, other = task.hide_future(state), task.hide_future(replace(state, waypoints=moved))
    np.testing.assert_array_equal(known.waypoint, state.waypoint)
    np.testing.assert_array_equal(known.waypoints, other.waypoints)
    law = Predictive(model=Steered(system), samples=32).bind_to(task)
    views = [View(task.observe(s, s.state)[None], s.state[None], s) for s in (state, replace(state, waypoints=moved))]
    first, second = (law.act(np.zeros((1, 2)), np.zeros((1, 3, law.n_memory)), view)[0] for view in views)
    np.testing.assert_array_equal(first, second)


def test_a_sequence_on_which_the_model_diverges_is_the_worst():
    system = continuous_car()
    task = PointToPoint().bind(system)
    began = task.begin(trial_seeds(2, 1))
    sequences = np.stack([np.ones((1, 4, 2)), -np.ones((1, 4, 2))])
    scores = ImaginedTrials(Exploding(system), task).scores(began.state[:, None], np.zeros((1, 0, 2)), sequences, began)
    assert scores[0, 0] == task.worst - 1.0 < scores[1, 0]


def test_a_stored_model_is_named_by_its_file(tmp_path):
    data = example_dataset()
    model = make_model("linear").fit(data, rng=np.random.default_rng(0))
    file = save_model(model, tmp_path / "body")
    task = PointToPoint().bind(data.system)
    bound = make_controller(f"predictive(model={str(file)!r}, horizon=3)").bind_to(task)
    assert isinstance(bound, Predictive)
    assert type(bound.imagined[0].dynamics) is type(model)


@pytest.mark.parametrize(
    "law, error, reason",
    [
        (lambda: Predictive(model="emulated_car", horizon=0), InvalidArgument, "expected horizon, hold >= 1"),
        (lambda: Predictive(model=[]), InvalidArgument, "expected at least one model, got none"),
        (
            lambda: Predictive(model=ExampleDynamics(System(["a"], [Channel("u", low=-1.0, high=1.0)], dt=0.05))),
            IncompatibleTask,
            "is of another system: states forward_speed",
        ),
    ],
)
def test_what_cannot_be_planned_with_is_refused(law, error, reason):
    with pytest.raises(error, match=reason):
        law().bind_to(PointToPoint().bind(switched_car()))
