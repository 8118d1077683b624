"""LQR against theory: the gain of python-control, equilibria, and what it balances."""

import control
import numpy as np
import pytest

from sysid_evo import DynamicsRunner, make_controller, make_robot, make_task
from sysid_evo.controllers import View
from sysid_evo.controllers.lqr import LinearModel, Lqr, linear_model
from sysid_evo.errors import IncompatibleTask, InvalidArgument
from sysid_evo.randomness import trial_seeds
from sysid_evo.system import Channel, System
from sysid_evo.tasks import PointToPoint
from sysid_evo.tasks.references import SetPoint
from sysid_evo.testing.examples import ExampleDynamics, continuous_car

MASS = System([Channel("position", "m"), Channel("speed", "m/s")], [Channel("force", "N", low=-4.0, high=4.0)], dt=0.1)
A, B, C = [[1.0, 0.1], [0.0, 0.9]], [[0.0], [0.1]], [0.0, 0.05]


def outputs(law, task, states, parameter=0.0):
    """Return the controls in ``states`` (E, nx), and the targets, of one trial each."""
    began = task.begin(trial_seeds(4, len(states)))
    seen = task.observe(began, states)[None]
    raw, _ = law.act(np.array([[parameter]]), np.zeros((1, len(states), 0)), View(seen, states[None], began))
    return task.system.actuate(raw[0]), began.target


def test_it_is_the_textbook_feedback_around_rest_at_the_target():
    task = SetPoint(channels="position", tolerance=0.1).bind(MASS)
    law = Lqr(a=A, b=B, c=C, weights={"speed": 0.2}, effort=0.5).bind_to(task)
    gain, _, _ = control.dlqr(A, B, np.diag([1.0, 0.2]), np.array([[0.5 / 16.0]]))
    states = np.array([0.2, 0.0]) + 0.1 * np.random.default_rng(1).standard_normal((6, 2))
    held = -0.5  # N, against the constant push
    for strength in (0.0, 0.3):
        controls, targets = outputs(law, task, states, strength)
        rest = np.concatenate([targets, np.zeros((6, 1))], axis=1)
        expected = held - np.exp(strength) * (states - rest) @ gain.T
        np.testing.assert_allclose(controls, np.clip(expected, -4.0, 4.0), atol=1e-6)


def test_a_dynamics_is_linearised_around_the_state_that_is_asked_for():
    body = ExampleDynamics(continuous_car())
    found = linear_model(body, np.array([1.0, 0.2, -3.0]))
    np.testing.assert_allclose(found.a, 0.9 * np.eye(3), atol=1e-9)
    np.testing.assert_allclose(found.b, body.push, atol=1e-9)
    np.testing.assert_allclose(found.c, body.offset, atol=1e-9)


def test_rest_is_where_nothing_changes():
    linear = LinearModel(np.array(A), np.array(B), np.array(C))
    state, push = linear.at_rest(np.array([0.7]), [0])
    np.testing.assert_allclose(state, [0.7, 0.0], atol=1e-12)
    np.testing.assert_allclose(linear.a @ state + linear.b @ push + linear.c, state, atol=1e-12)


@pytest.mark.parametrize("robot", ["pendulum", "cart_pole"])
def test_it_balances_what_falls_over_by_itself(robot):
    runner, task = DynamicsRunner(make_robot(robot).dynamics), make_task("balance")
    fitness = runner.bind(make_controller(f"lqr(model={robot})"), task)(np.zeros((1, 1)), trial_seeds(1, 10)).fitness
    assert fitness.min() > 95.0


def test_what_it_cannot_do_is_refused():
    for arguments in ({}, {"a": A}, {"model": "pendulum", "a": A, "b": B}):
        with pytest.raises(InvalidArgument, match="expected either a model, or the matrices a and b"):
            Lqr(**arguments)
    with pytest.raises(InvalidArgument, match="expected effort > 0"):
        Lqr(a=A, b=B, effort=0.0)
    with pytest.raises(
        IncompatibleTask, match="lqr needs a task with target states such as set_point, got PointToPoint"
    ):
        Lqr(model="emulated_car").bind_to(PointToPoint().bind(continuous_car()))
    task = SetPoint(channels="position").bind(MASS)
    with pytest.raises(IncompatibleTask, match="no state 'heat'"):
        Lqr(a=A, b=B, weights={"heat": 1.0}).bind_to(task)
    with pytest.raises(InvalidArgument, match="no control acts on a state within one sample"):
        Lqr(a=[[0.5, 0.0], [0.0, 0.5]], b=[[0.0], [0.0]]).bind_to(task)
    with pytest.raises(InvalidArgument, match="no feedback stabilises this model"):
        Lqr(a=[[1.5, 0.0], [0.0, 0.5]], b=[[0.0], [1.0]]).bind_to(task)
