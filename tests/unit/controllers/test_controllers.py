"""Controllers beside the recurrent network, against loops over single numbers and against what they are for."""

import math
from dataclasses import replace

import numpy as np
import pytest

from sysid_evo import DynamicsRunner, make_controller, make_robot, make_task
from sysid_evo.controllers import LinearFeedback, RecurrentNetwork, View
from sysid_evo.controllers.networks import FeedForward
from sysid_evo.controllers.pid import HEAD, LOOP, Pid
from sysid_evo.controllers.pursuit import Pursuit
from sysid_evo.errors import IncompatibleTask, InvalidArgument, ShapeError
from sysid_evo.randomness import trial_seeds
from sysid_evo.system import Channel, System
from sysid_evo.tasks import PointToPoint, TaskState
from sysid_evo.tasks.references import SetPoint
from sysid_evo.testing.examples import continuous_car, pendulum, switched_car
from tests.fixtures.by_hand import network_by_hand

TRIALS = TaskState(np.empty((0, 3)), np.empty((0, 3)), np.empty(0, dtype=bool))


def bound_to_car(controller):
    return controller.bind_to(PointToPoint().bind(continuous_car()))


def outputs(controller, parameters, observations):
    """Return what one candidate does on a sequence of observations (T, n), one after the other, (T, n_outputs)."""
    memory, found = np.zeros((1, 1, controller.n_memory)), []
    for observation in np.asarray(observations, dtype=float):
        seen = observation.reshape(1, 1, -1)
        raw, memory = controller.act(np.asarray(parameters, dtype=float)[None], memory, View(seen, seen, TRIALS))
        found.append(raw[0, 0])
    return np.array(found)


def test_a_network_with_two_hidden_layers_equals_the_loop_over_its_units():
    network = FeedForward(hidden=[3, 2]).bind(4, 1)
    assert network.n_parameters == 5 * 3 + 4 * 2 + 3 * 1
    rng = np.random.default_rng(0)
    theta, observation = rng.standard_normal(network.n_parameters), rng.standard_normal(4)
    values, numbers = list(observation), iter(theta)
    for n_out in (3, 2, 1):
        weights = [[next(numbers) for _ in range(n_out)] for _ in values]
        bias = [next(numbers) for _ in range(n_out)]
        values = [
            math.tanh(bias[j] + sum(w[j] * x for w, x in zip(weights, values, strict=True))) for j in range(n_out)
        ]
    assert outputs(network, theta, [observation])[0] == pytest.approx(values)


def test_linear_feedback_weighs_the_observations_that_are_named_and_saturates():
    law = bound_to_car(LinearFeedback(inputs=["yaw_rate", "waypoint_angle"]))
    assert law.n_parameters == 3 * 2
    found = outputs(law, [0.1, 0.0, -0.2, 0.4, 0.05, -5.0], [[1.0, 9.0, 2.0, 1.5, 9.0]])
    np.testing.assert_allclose(found, [[0.1 * 2.0 - 0.2 * 1.5 + 0.05, -1.0]])


def pid_by_hand(gains, bias, errors, step):
    """A textbook PID with conditional integration; ``step`` is dt / T."""
    integral, last, found = 0.0, None, []
    for error in errors:
        change = 0.0 if last is None else (error - last) / step
        last = error
        grown = integral + error * step
        output = bias + gains[0] * error + gains[1] * grown + gains[2] * change
        if not (abs(output) > 1.0 and output * gains[1] * error > 0.0):
            integral = grown
        found.append(min(max(bias + gains[0] * error + gains[1] * integral + gains[2] * change, -1.0), 1.0))
    return found


def test_a_pid_loop_equals_the_textbook():
    law = bound_to_car(Pid(loops={"steer": "waypoint_distance"}, scales={"waypoint_distance": 2.0}, time=0.5))
    assert law.n_parameters == 3 + 2
    distances = 2.0 * np.sin(0.3 * np.arange(60)) + 0.5
    observations = np.zeros((60, 5))
    observations[:, 4] = distances
    found = outputs(law, [0.7, 1.5, 0.02, 0.3, -0.1], observations)
    expected = pid_by_hand((0.7, 1.5, 0.02), -0.1, list(distances / 2.0), 0.05 / 0.5)
    np.testing.assert_allclose(found[:, 1], expected, atol=1e-12)
    np.testing.assert_allclose(found[:, 0], 0.3)
    assert np.sum(np.abs(found[:, 1]) == 1.0) >= 3


def test_an_integral_does_not_wind_up():
    law = bound_to_car(Pid(loops={"steer": "waypoint_distance"}, time=0.05))
    theta = [0.0, 0.1, 0.0, 0.0, 0.0]
    observations = np.zeros((120, 5))
    observations[:100, 4], observations[100:, 4] = 1.0, -1.0
    steer = outputs(law, theta, observations)[:, 1]
    assert steer[99] == pytest.approx(1.0)
    assert steer[109] == pytest.approx(0.0, abs=0.11)  # wound up it would still be at its limit


def test_an_angle_that_jumps_by_a_turn_does_not_kick_the_derivative():
    law = bound_to_car(Pid(loops={"steer": "waypoint_angle"}, time=0.05))
    observations = np.zeros((2, 5))
    observations[:, 3] = 3.1, -3.1
    turned = (2.0 * math.pi - 6.2) / math.pi
    assert outputs(law, [0.0, 0.0, 0.5, 0.0, 0.0], observations)[1, 1] == pytest.approx(0.5 * turned)


class Errors(PointToPoint):
    observations = (Channel("bias"), Channel("speed_error", "m/s"), Channel("x"), Channel("y"), Channel("z"))


def test_without_loops_a_pid_takes_the_errors_of_the_task_or_all_that_it_shows():
    system = continuous_car()
    assert Pid().bind_to(Errors().bind(system)).n_parameters == 3 * 2 * 1 + 2
    assert Pid().bind_to(PointToPoint().bind(system)).n_parameters == 3 * 2 * 4 + 2
    turning = SetPoint(channels="angle").bind(pendulum())
    bound = Pid().bind_to(turning)
    assert bound.n_parameters == 3 + 1
    assert turning.observations[int(bound.law.parameters[HEAD.size + LOOP.observation])].name == "sin_angle_error"


@pytest.mark.parametrize(
    "spec, reason",
    [
        ("linear(inputs=[theta])", "linear: the task has no observation 'theta'; there are bias, forward_speed"),
        ("pid(loops={heater: yaw_rate})", "pid: the system has no control 'heater'; there are drive, steer"),
        ("pid(scales={theta: 2})", "pid: scales: the task has no observation 'theta'"),
        ("pursuit(steer=wheel)", r"name yours with drive= and steer=\): the system has no control 'wheel'"),
    ],
)
def test_a_channel_that_is_not_there_is_named_with_those_that_are(spec, reason):
    with pytest.raises(IncompatibleTask, match=reason):
        bound_to_car(make_controller(spec))


@pytest.mark.parametrize(
    "made, reason",
    [
        (lambda: make_controller("feed_forward(hidden=[])"), "expected hidden >= 1"),
        (lambda: make_controller("feed_forward(hidden=[3, 0])"), "expected hidden >= 1"),
        (lambda: make_controller("linear(inputs=[a, a])"), "expected different inputs"),
        (lambda: make_controller("pid(time=0)"), "expected time > 0 s, got 0"),
        (lambda: make_controller("pid(loops=steer)"), "expected loops such as"),
        (lambda: make_controller("pid(scales={a: -1})"), "expected scales > 0, got a -1"),
        (lambda: make_controller("pursuit(look=0)"), "expected look, acceleration, gain > 0"),
        (lambda: RecurrentNetwork(hidden=0), "expected at least one hidden unit, got 0"),
        (lambda: Pid().bind(5, 2), r"Pid depends on the names of a task's channels: use bind_to\(task\)"),
    ],
)
def test_wrong_arguments_are_refused_when_they_are_given(made, reason):
    with pytest.raises(InvalidArgument, match=reason):
        made()


def test_a_constant_controller_with_zeros_keeps_every_control_at_rest():
    controls = Channel("valve", low=0.0, high=4.0, neutral=1.0), Channel("side", levels=(-1.0, 0.0, 1.0))
    system = System((Channel("speed"),), controls, 0.1)
    law = make_controller("constant").bind_to(make_task("set_point(channels=speed)").bind(system))
    assert law.is_baseline
    raw = outputs(law, [0.0, 0.0], np.zeros((2, 3)))
    np.testing.assert_allclose(system.actuate(raw), [[1.0, 0.0]] * 2)
    np.testing.assert_allclose(system.actuate(outputs(law, [0.5, 9.0], np.zeros((1, 3)))), [[2.0, 1.0]])


@pytest.mark.parametrize("backward", [False, True])
def test_pursuit_drives_the_emulated_car_to_waypoints_as_it_was_made(backward):
    runner = DynamicsRunner(make_robot("emulated_car").dynamics)
    law = Pursuit(backward=backward)
    assert law.is_baseline
    fitness = runner.bind(law, make_task("point_to_point(horizon=200)"))(np.zeros((1, 4)), trial_seeds(5, 12)).fitness
    assert fitness.mean() > 3.8


def test_pursuit_leaves_other_controls_neutral():
    car = continuous_car()
    car = replace(car, controls=(*car.controls, Channel("lamp", low=0.0, high=4.0, neutral=3.0)))
    law = Pursuit().bind_to(PointToPoint().bind(car))
    raw = outputs(law, np.zeros(4), [[1.0, 0.5, 0.1, 0.4, 1.0]])
    assert car.actuate(raw)[0, 2] == pytest.approx(3.0)


def test_outputs_made_from_controls_give_these_controls_or_the_nearest_legal_ones():
    legal = np.array([[-1.0, 0.0], [0.0, 1.0], [1.0, -1.0]])
    for system in (switched_car(), continuous_car()):
        np.testing.assert_array_equal(system.actuate(system.raw_output(legal)), legal)
    found = switched_car().raw_output(np.array([0.6, -7.0]))
    np.testing.assert_array_equal(switched_car().actuate(found), [1.0, -1.0])
    assert continuous_car().raw_output(np.array([0.6, -7.0])) == pytest.approx([0.6, -1.0])


@pytest.mark.parametrize("hidden, inputs, outputs", [(6, 5, 2), (1, 3, 1), (4, 1, 3)])
def test_every_candidate_in_every_trial_equals_the_scalar_loop(hidden, inputs, outputs):
    rng = np.random.default_rng(4)
    network = RecurrentNetwork(hidden=hidden).bind(inputs, outputs)
    parameters = rng.standard_normal((3, network.n_parameters))
    observations = rng.standard_normal((8, 3, 2, inputs))
    memory = np.zeros((3, 2, network.n_memory))
    acted = []
    for observation in observations:
        raw, memory = network.act(parameters, memory, View(observation, observation, TRIALS))
        acted.append(raw)
    for p in range(3):
        for e in range(2):
            expected = network_by_hand(parameters[p], observations[:, p, e], hidden, outputs)
            np.testing.assert_allclose([raw[p, e] for raw in acted], expected, rtol=1e-12, atol=1e-14)


def test_the_network_of_the_paper_has_78_weights():
    assert RecurrentNetwork(hidden=6).bind(5, 2).n_parameters == 78
    assert make_controller("recurrent").bind_to(PointToPoint().bind(switched_car())).n_parameters == 78


def test_a_wrong_number_of_weights_is_refused():
    network = RecurrentNetwork().bind(5, 2)
    view = View(np.zeros((1, 1, 5)), np.zeros((1, 1, 3)), TRIALS)
    with pytest.raises(ShapeError, match=r"parameters: expected shape \(any, 78\), got \(1, 77\)"):
        network.act(np.zeros((1, 77)), np.zeros((1, 1, 6)), view)


@pytest.mark.parametrize(
    "controller",
    [LinearFeedback(), LinearFeedback(inputs=("waypoint_distance", "forward_speed")), FeedForward(hidden=[3, 2]),
     RecurrentNetwork(hidden=3)],
    ids=["linear", "two inputs", "feed forward", "recurrent"],
)  # fmt: skip
def test_with_its_first_steps_a_large_observation_has_the_effect_of_a_small_one(controller):
    bound, sizes = bound_to_car(controller), np.array([1.0, 5.0, 1.0, 2.0, 30.0])
    rng = np.random.default_rng(1)
    theta, small = 0.3 * rng.standard_normal(bound.n_parameters), rng.standard_normal((4, 5))
    expected = outputs(bound, theta, small)
    np.testing.assert_allclose(outputs(bound, theta * bound.first_steps(sizes), small * sizes), expected, atol=1e-12)
    np.testing.assert_array_equal(bound.first_steps(np.ones(5)), 1.0)


def test_a_controller_without_weights_of_observations_has_equal_first_steps():
    pid = bound_to_car(Pid())
    np.testing.assert_array_equal(pid.first_steps(np.full(5, 9.0)), np.ones(pid.n_parameters))
