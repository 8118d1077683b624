"""Emulated robots without a pose: their physics against theory, what their sensors say, how they are recorded."""

import math
from dataclasses import fields

import numpy as np
import pytest

from hardware.emulation.cart_pole import GRAVITY, CartPoleParameters, CartPolePhysics
from hardware.emulation.pendulum import TORQUE, PendulumParameters, PendulumPhysics
from hardware.emulation.sensed_robot import Equations, SensedRobot, Sensor, rate
from hardware.emulation.thermal import FINE_DT, LATENCY, ROOM, ThermalParameters, ThermalPhysics
from hardware.robot import find_robot
from hardware.run_report import StopReason, StopRequest
from sysid_evo.angles import TURN
from sysid_evo.errors import InvalidArgument, InvalidSystem, ShapeError
from sysid_evo.registry import make_robot, robots
from sysid_evo.system import Channel, System
from sysid_evo.tasks.task import make_task

ALMOST_NONE = 1e-9
NAMES = ("pendulum", "cart_pole", "thermal")


def run(physics, state, control, steps):
    """Return the carries (steps + 1, n_carry) from ``state`` on, under one control and without noise."""
    system = physics.system
    history = np.tile(state, (1, physics.n_lags + 1, 1))
    carry = physics.start(history, np.tile(system.neutral_control, (1, physics.n_lags, 1)), np.zeros((1, 0)))
    carries = [carry]
    for _ in range(steps):
        carries.append(physics.step(carries[-1], np.array([[control]])))
    return np.array(carries)[:, 0]


def test_a_pendulum_without_friction_swings_as_in_theory_and_keeps_its_energy():
    p = PendulumParameters(viscous=ALMOST_NONE, dry=ALMOST_NONE)
    path = run(PendulumPhysics(p), [0.1, 0.0], 0.0, 1000)
    crossings = np.flatnonzero((path[:-1, 0] > 0.0) & (path[1:, 0] <= 0.0)) * 0.005
    assert np.diff(crossings).mean() == pytest.approx(2.0 * math.pi * math.sqrt(p.inertia / p.weight), rel=0.005)
    high = run(PendulumPhysics(p), [2.0, 0.0], 0.0, 1000)
    energy = 0.5 * p.inertia * high[:, 1] ** 2 - p.weight * np.cos(high[:, 0])
    assert np.ptp(energy) < 0.03 * p.weight


def test_the_pendulum_s_motor_cannot_lift_it():
    path = run(PendulumPhysics(), [0.0, 0.0], TORQUE, 2000)
    assert np.abs(path[:, 0]).max() < 1.0
    assert path[-1, 0] == pytest.approx(math.asin(TORQUE / PendulumParameters().weight), abs=0.02)


def test_a_cart_pole_without_friction_keeps_its_energy():
    p = CartPoleParameters(rail_friction=ALMOST_NONE, hinge_friction=ALMOST_NONE)
    x, v, a, w, _ = run(CartPolePhysics(p), [0.2, 0.0, 2.0, 0.0], 0.0, 600).T
    across, up = v + p.length * w * np.cos(a), p.length * w * np.sin(a)
    energy = 0.5 * p.cart * v**2 + 0.5 * p.bob * (across**2 + up**2) + 0.5 * p.bands * x**2
    energy -= p.bob * GRAVITY * p.length * np.cos(a)
    assert np.ptp(0.5 * p.cart * v**2) > 0.05
    assert np.ptp(energy) < 0.04


def test_the_block_warms_late_and_ends_where_power_and_loss_balance():
    p = ThermalParameters()
    path = run(ThermalPhysics(p), [ROOM], 1.0, round(120.0 / FINE_DT))
    assert np.all(path[: LATENCY + 1, 2] == 0.0)
    assert path[LATENCY + 1, 2] > 0.0
    assert path[-1, 0] == pytest.approx(ROOM + p.power / p.loss, abs=0.1)


@pytest.mark.parametrize("name", NAMES)
def test_a_seed_makes_another_of_its_kind_and_the_same_one_again(name):
    nominal, other, same = (find_robot(spec) for spec in (name, f"{name}:1", f"{name}:1"))
    states = np.tile(nominal.system.neutral_state + 0.5, (1, 4, 1))
    steps = []
    for dynamics in (nominal.dynamics, other.dynamics, same.dynamics):
        carry = dynamics.start(states[:, : dynamics.n_lags + 1], np.zeros((1, dynamics.n_lags, 1)), np.zeros((1, 0)))
        steps.append(dynamics.step(carry, np.array([[0.3]])))
    assert np.array_equal(steps[1], steps[2])
    assert not np.allclose(steps[0], steps[1], rtol=1e-6)
    with pytest.raises(InvalidArgument, match="seed"):
        find_robot(f"{name}(seed=-1)")


def test_every_quantity_must_be_positive():
    for kind in (PendulumParameters, CartPoleParameters, ThermalParameters):
        for item in fields(kind):
            with pytest.raises(InvalidArgument, match=item.name):
                kind(**{item.name: 0.0})


def test_only_the_angle_is_measured_in_whole_steps_and_the_speed_estimated_from_it():
    robot = find_robot("pendulum")
    recorded = robot.record(seed=1, duration=20.0)
    log = recorded.logs[0]
    steps = log.extra["angle"] / (2.0 * math.pi / 4096.0)
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    np.testing.assert_array_equal(log.extra["angular_speed"][2:-2], rate(log.extra["angle"], 0.005)[2:-2])
    for episode in recorded.dataset:
        step = np.diff(episode.states[:, 0]) / episode.dt
        assert np.abs(step - 0.5 * (episode.states[1:, 1] + episode.states[:-1, 1])).max() < 0.6


@pytest.mark.parametrize("name, duration", [("pendulum", 10.0), ("cart_pole", 10.0), ("thermal", 20.0)])
def test_a_recording_begins_where_it_is_let_go_and_repeats(name, duration):
    robot = find_robot(name)
    assert isinstance(robot, SensedRobot)
    first, again, other = (robot.record(seed=seed, duration=duration).dataset for seed in (3, 3, 4))
    assert first.fingerprint == again.fingerprint != other.fingerprint
    assert first.system == robot.system
    assert len({round(float(episode.states[0, -1]), 2) for episode in first}) > 3


def test_a_rate_is_exact_for_a_cubic_and_repeats_at_the_ends():
    time = 0.1 * np.arange(9)
    found = rate(time**3, 0.1)
    np.testing.assert_allclose(found[2:-2], 3.0 * time[2:-2] ** 2, atol=1e-12)
    assert found[0] == found[1] == found[2]
    assert not rate(np.ones(3), 0.1).any()


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

    system = System((Channel("x", low=0.0, high=0.5),), (Channel("u", low=0.0, high=1.0),), dt=0.2, name="vessel")


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
    turned = after(Wheel(), [0.0, 0.0], [2.0, 0.5], 30.0)
    assert turned[1] == pytest.approx(2.0, rel=1e-9)
    assert turned[0] == pytest.approx(2.0 * 30.0 - 2.0, rel=1e-6)


@pytest.mark.parametrize("physics", [Decay(), Wheel(), Vessel()], ids=["no limits", "an angle and levels", "limits"])
def test_it_is_recorded_row_by_row_and_what_is_recorded_is_what_it_does(physics):
    recorded = SensedRobot("mine", physics).record(seed=2, duration=200.0 * physics.system.dt).dataset
    assert recorded.system == physics.system
    for episode in recorded:
        np.testing.assert_allclose(episode.states[0], physics.system.neutral_state)
        follows = physics.step(episode.states[:-1], episode.controls)
        if physics.state_bounds is not None:
            follows = np.clip(follows, *physics.state_bounds)
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


class Tank(Equations):
    """A level that a pump raises and a leak lowers."""

    system = System(
        states=(Channel("level", "m", low=0.0, high=1.0),),
        controls=(Channel("pump", "V", low=0.0, high=10.0), Channel("valve", levels=(0.0, 1.0))),
        dt=0.5,
    )
    flow, leak = 0.02, 1.0

    def rates_of_change(self, states, controls):
        return self.flow * controls[:, :1] - self.leak * (0.1 + controls[:, 1:]) * states


def findings(physics):
    return {finding.check: finding for finding in SensedRobot("tank", physics).self_test(seconds=2.0, seed=1)}


def test_correct_equations_pass_and_their_responses_are_reported():
    found = findings(Tank())
    assert all(finding.ok for finding in found.values())
    assert found["system"].sentence.startswith(
        "States: level (0 to 1 m). Controls: pump (0 to 10 V), valve (0, 1). One sample every 0.5 s"
    )
    assert "level 0 m" in found["sensors"].sentence
    assert found["rest"].sentence == "Without a command for 150 s it does not move."
    assert "at 0 V: level 0 m; at 10 V: level 0 to 1 m (level held at the limit)" in found["pump"].sentence
    assert "with the other controls full, at 0: level 0 to 1 m" in found["valve"].sentence


class Forgotten(Tank):
    flow = 0.0


class Bursting(Tank):
    system = System(Tank.system.states, Tank.system.controls, dt=0.5)
    state_bounds = None

    def rates_of_change(self, states, controls):
        return controls[:, :1] + states**2


class Unlimited(Tank):
    system = System(states=("level",), controls=("pump", Channel("valve", low=0.0, high=1.0)), dt=0.5)


@pytest.mark.parametrize(
    ("physics", "said"),
    [
        (Forgotten, "has no effect in 150 s"),
        (Bursting, "at 10 V: it leaves all bounds: level is not finite after"),
        (Unlimited, "give low and high"),
    ],
)
def test_a_control_that_does_nothing_bursts_or_has_no_limits_is_found_before_it_is_recorded(physics, said):
    found = findings(physics())
    assert "rest" not in found or found["rest"].ok
    assert not found["pump"].ok
    assert said in found["pump"].sentence


def test_a_stop_from_outside_leaves_the_rest_out():
    stops = StopRequest()
    stops.request(StopReason.SIGINT)
    found = SensedRobot("tank", Tank()).self_test(seconds=2.0, stop=stops)
    assert [finding.check for finding in found] == ["system", "sensors", "rest", "speed"]


@pytest.mark.parametrize("name", ["pendulum", "cart_pole", "thermal", "gymnasium(id='MountainCar-v0')"])
def test_every_robot_without_a_pose_that_comes_with_the_program_is_sound(name):
    robot = find_robot(name)
    found = {finding.check: finding for finding in robot.self_test(seconds=1.0, seed=2)}
    assert all(finding.ok for finding in found.values()), [f.sentence for f in found.values() if not f.ok]
    assert all(channel.name in found["system"].sentence for channel in robot.system.states)


def test_an_environment_reports_its_episodes_under_random_controls():
    found = {f.check: f.sentence for f in find_robot("gymnasium(id='CartPole-v1')").self_test(seconds=8.0, seed=3)}
    assert "force (-10, 10 N)" in found["system"]
    assert "in 400 steps; rewards from 1 to 1 a step" in found["episodes"]
    low, high = (float(word) for word in found["episodes"].split("after ")[1].split(" steps")[0].split(" to "))
    assert 5 < low < high < 200
    assert np.isfinite(low)


@pytest.mark.parametrize("name", ["pendulum", "cart_pole", "thermal"])
def test_a_robot_without_a_pose_has_a_task_that_fits_it(name):
    robot = make_robot(name)
    assert make_task(robot.default_task).bind(robot.system).system is robot.system
