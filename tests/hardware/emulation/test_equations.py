"""Equations of a user's own as a robot: integrated as theory says, recorded row by row, refused in sentences."""

import math

import numpy as np
import pytest

from hardware.emulation.sensed_robot import Equations, SensedRobot, Sensor
from sysid_evo.angles import TURN
from sysid_evo.errors import InvalidArgument, InvalidSystem, ShapeError
from sysid_evo.registry import make_robot, robots
from sysid_evo.system import Channel, System


class Decay(Equations):
    """x' = u - x, whose solution is known."""

    system = System(states=("x",), controls=(Channel("u", low=-1.0, high=1.0),), dt=0.2)
    substeps = 1

    def rates_of_change(self, states, controls):
        return controls - states


class Wheel(Equations):
    """An angle that comes round, turned by a switch; the names of the states say which rate is which."""

    system = System(
        states=(Channel("angle", "rad", period=TURN), Channel("spin", "rad/s")),
        controls=(Channel("push", levels=(-1.0, 0.0, 2.0)), Channel("brake", low=0.0, high=1.0)),
        dt=0.05,
        name="wheel",
    )

    def rates_of_change(self, states, controls):
        spin = states[:, 1]
        return {"spin": controls[:, 0] - (0.5 + controls[:, 1]) * spin, "angle": spin}


class Vessel(Decay):
    """The same with limits: what is above them flows over."""

    system = System(
        states=(Channel("x", low=0.0, high=0.5),), controls=(Channel("u", low=0.0, high=1.0),), dt=0.2, name="vessel"
    )


def after(physics, state, control, seconds):
    carry = physics.start(np.array([[state]]), np.empty((1, 0, len(control))))
    for _ in range(round(seconds / physics.system.dt)):
        carry = physics.step(carry, np.array([control]))
    return carry[0]


def test_the_error_of_a_step_falls_with_the_fourth_power_of_its_length():
    class Finer(Decay):
        substeps = 2

    exact = 1.0 - 0.5 * math.exp(-2.0)
    coarse, fine = (abs(after(physics, [0.5], [1.0], 2.0)[0] - exact) for physics in (Decay(), Finer()))
    assert coarse < 1e-5
    assert coarse / fine == pytest.approx(16.0, rel=0.2)


def test_rates_may_be_given_by_the_names_of_the_states_in_any_order():
    turned = after(Wheel(), [0.0, 0.0], [2.0, 0.5], 60.0)
    assert turned[1] == pytest.approx(2.0, rel=1e-9)
    assert turned[0] == pytest.approx(2.0 * 60.0 - 2.0, rel=1e-6)


@pytest.mark.parametrize(
    "physics", [Decay(), Wheel(), Vessel()], ids=["no limits", "an angle, levels and two controls", "limits"]
)
def test_it_is_recorded_row_by_row_and_what_is_recorded_is_what_it_does(physics):
    robot = SensedRobot("mine", physics)
    recorded = robot.record(seed=2, duration=300.0 * physics.system.dt)
    assert recorded.dataset.system == physics.system
    for episode in recorded.dataset:
        np.testing.assert_allclose(episode.states[0], physics.system.neutral_state)
        follows = physics.step(episode.states[:-1], episode.controls)
        if physics.envelope is not None:
            follows = np.clip(follows, *physics.envelope)
        np.testing.assert_allclose(physics.system.difference(episode.states[1:], follows), 0.0, atol=1e-9)


def test_states_with_limits_stay_within_them_in_a_session():
    with SensedRobot("vessel", Vessel()).connect(seed=0) as connection:
        connection.measure(1.0)
        connection.send(np.array([1.0]), valid_for=100.0)
        for _ in range(20):
            connection.measure(1.0)
        assert connection.state[0] == 0.5


def test_a_sensor_that_is_named_has_its_noise_and_resolution_and_the_others_are_exact():
    class Noisy(Wheel):
        sensors = {"angle": Sensor(noise=0.02, resolution=0.01)}  # noqa: RUF012  # as a user writes it

    with SensedRobot("wheel", Noisy()).connect(seed=3) as connection:
        readings = [connection.measure(1.0) and connection.reading for _ in range(400)]
    angles, spins = np.array(readings).T
    assert angles.std() == pytest.approx(0.02, rel=0.2)
    np.testing.assert_allclose(angles, 0.01 * np.round(angles / 0.01), atol=1e-12)
    assert not spins.any()


def test_what_is_missing_or_wrong_is_said_by_name():
    with pytest.raises(InvalidSystem, match="Nothing: expected a class attribute system = System"):

        class Nothing(Equations):
            def rates_of_change(self, states, controls):
                return states

    class Misnamed(Wheel):
        def rates_of_change(self, states, controls):
            return {"angel": states[:, 1], "spin": states[:, 1]}

    class Misshapen(Wheel):
        def rates_of_change(self, states, controls):
            return states[:, :1]

    with pytest.raises(InvalidSystem, match=r"Misnamed.rates_of_change: .* of angle, spin, got angel, spin"):
        after(Misnamed(), [0.0, 0.0], [0.0, 0.0], 0.05)
    with pytest.raises(ShapeError, match=r"Misshapen.rates_of_change: expected shape \(1, 2\)"):
        after(Misshapen(), [0.0, 0.0], [0.0, 0.0], 0.05)


def test_dynamics_that_are_registered_instead_of_a_robot_are_refused_with_what_to_write(register):
    register(robots, "wheel_of_mine", Wheel)
    with pytest.raises(InvalidArgument, match=r"'wheel_of_mine': expected a robot, got the dynamics Wheel. .* Sensed"):
        make_robot("wheel_of_mine")
