"""An environment of Gymnasium as a robot: its channels, its actions, and what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hardware.robot import find_robot
from hardware.simulators.gymnasium_robot import GymnasiumRobot, parse_angles
from hardware.testing import check_robot
from sysid_evo.angles import TURN
from sysid_evo.errors import IncompatibleSystem, InvalidArgument
from tests.fixtures.environments import NAME, register

register()
CLASSIC = ("Pendulum-v1", "CartPole-v1", "MountainCar-v0", "MountainCarContinuous-v0", "Acrobot-v1")


def rotor(**parameters):
    return GymnasiumRobot(id=NAME, **parameters)


@pytest.mark.parametrize("name", CLASSIC)
def test_the_states_of_a_classic_environment_are_its_own_in_its_own_order(name):
    robot = GymnasiumRobot(id=name)
    with robot.simulator.open() as session:
        inner: Any = session._env.unwrapped
        state = session.reset(3)
        for k in range(5):
            np.testing.assert_allclose(np.sin(state), np.sin(np.asarray(inner.state, dtype=float)), atol=1e-5)
            state, *_ = session.step(robot.system.actuate(np.array([0.9, -0.9][k % 2 : k % 2 + 1])))


@pytest.mark.parametrize("name", CLASSIC)
def test_a_classic_environment_can_begin_in_any_state(name):
    environment = GymnasiumRobot(id=name).simulator
    start = np.array([0.1, 0.02, -0.05, 0.03][: environment.system.nx])
    control = environment.system.actuate(np.array([0.5]))
    with environment.open() as session:
        first, second = (session.reset(seed, start) for seed in (1, 2))
        np.testing.assert_array_equal(first, start)
        once = session.step(control)[0]
        session.reset(7, second)
        np.testing.assert_array_equal(session.step(control)[0], once)


def test_the_robot_keeps_the_contract_of_robots_and_is_not_a_physical_one():
    check_robot("gymnasium", id="CartPole-v1")
    assert not find_robot('gymnasium(id="CartPole-v1")').physical
    assert find_robot("serial").physical


def test_channels_and_controls_get_other_names_and_keep_all_else():
    plain = GymnasiumRobot(id="Pendulum-v1").system
    named = GymnasiumRobot(id="Pendulum-v1", channels="tilt [rad], rate", controls="motor [mN m]").system
    assert (named.state_names, named.controls[0].name, named.controls[0].unit) == (("tilt", "rate"), "motor", "mN m")
    kept = [
        [(c.low, c.high, c.levels, c.neutral, c.period, c.description) for c in (*system.states, *system.controls)]
        for system in (plain, named)
    ]
    assert kept[0] == kept[1]
    assert GymnasiumRobot(id="CartPole-v1", controls="push").system.controls[0].levels == (-10.0, 10.0)
    with pytest.raises(InvalidArgument, match=r"controls: expected 1 names.*force"):
        GymnasiumRobot(id="CartPole-v1", controls="left, right")


def test_a_cosine_and_its_sine_become_one_periodic_state_in_the_place_of_the_first():
    system = rotor(angle="1,2").system
    assert system.state_names == ("observation_0", "angle_1")
    assert system.periods == {1: TURN}
    assert rotor().system.state_names == ("observation_0", "observation_1", "observation_2")
    environment = rotor(angle="1,2").simulator
    np.testing.assert_allclose(environment.observations.state([0.5, np.cos(2.5), np.sin(2.5)]), [0.5, 2.5])


def test_channels_are_named_with_their_units_and_keep_limits_and_period():
    system = rotor(angle="1,2", channels="speed [rad/s], angle").system
    assert [(c.name, c.unit) for c in system.states] == [("speed", "rad/s"), ("angle", "rad")]
    assert system.periods == {1: TURN}
    assert rotor().system.states[1].high == 1.0
    assert rotor().system.states[0].high == np.inf


def test_the_time_of_a_step_is_what_the_environment_says_unless_it_is_given():
    assert rotor().system.dt == 0.1
    assert rotor(dt=0.02).system.dt == 0.02
    assert GymnasiumRobot(id="CartPole-v1").system.dt == 0.02
    assert GymnasiumRobot(id="Pendulum-v1").system.dt == 0.05


@pytest.mark.parametrize(
    ("actions", "levels", "control", "action"),
    [
        ("discrete", [(-1.0, 0.0, 1.0)], [1.0], 1),
        ("several", [(0.0, 1.0, 2.0), (0.0, 1.0)], [2.0, 0.0], [2, 0]),
        ("binary", [(0.0, 1.0), (0.0, 1.0)], [0.0, 1.0], [0, 1]),
        ("box", [None], [0.25], [0.25]),
    ],
)
def test_actions_become_controls_and_controls_actions(actions, levels, control, action):
    robot = rotor(settings={"actions": actions})
    assert [channel.levels for channel in robot.system.controls] == levels
    with robot.simulator.open() as session:
        session.reset(0)
        session.step(np.array(control))
        inner: Any = session._env.unwrapped
        np.testing.assert_array_equal(inner.given, action)


def test_the_force_of_the_cart_has_the_sign_of_its_push():
    environment = GymnasiumRobot(id="CartPole-v1").simulator
    with environment.open() as session:
        session.reset(0, np.zeros(4))
        assert session.step(np.array([10.0]))[0][1] > 0.1
        session.reset(0, np.zeros(4))
        assert session.step(np.array([-10.0]))[0][1] < -0.1


@pytest.mark.parametrize(
    ("parameters", "error", "words"),
    [
        ({"id": "Pendulum-v99"}, InvalidArgument, "no environment can be made of 'Pendulum-v99'"),
        ({"id": NAME, "angle": "1,7"}, InvalidArgument, "from 0 to 2; got '1,7'"),
        ({"id": NAME, "angle": "x"}, InvalidArgument, "expected the numbers of a cosine and of its sine"),
        ({"id": NAME, "angle": "1,2; 2"}, InvalidArgument, "stands in two angles"),
        ({"id": NAME, "channels": "speed"}, InvalidArgument, "expected 3 names"),
        ({"id": NAME, "dt": 0.0}, InvalidArgument, "dt: expected a number above 0"),
        ({"id": NAME, "settings": {"limit": np.inf}}, IncompatibleSystem, "a Box of them with finite limits"),
        ({"id": "FrozenLake-v1"}, IncompatibleSystem, "expected a Box of at most 64 observations in a row"),
    ],
)
def test_what_cannot_be_a_robot_is_refused_in_a_sentence(parameters, error, words):
    with pytest.raises(error, match=words):
        GymnasiumRobot(**parameters)


def test_the_control_loop_is_not_for_environments():
    with pytest.raises(IncompatibleSystem, match="it has no clock and no tracker"):
        rotor().connect()


def test_angles_are_read_from_their_text():
    assert parse_angles("x", "0,1; 4", 5) == ((0, 1), (4,))
    assert parse_angles("x", "", 5) == ()
