"""Emulated robots without a pose: their physics against theory, what their sensors say, how they are recorded."""

import math
from dataclasses import fields

import numpy as np
import pytest

from hardware.emulation.cart_pole import GRAVITY, CartPoleParameters, CartPolePhysics
from hardware.emulation.pendulum import TORQUE, PendulumParameters, PendulumPhysics
from hardware.emulation.sensed_robot import SensedRobot, rate
from hardware.emulation.thermal import FINE_DT, LATENCY, ROOM, ThermalParameters, ThermalPhysics
from hardware.robot import find_robot
from sysid_evo.errors import InvalidArgument

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


def test_a_pendulum_without_friction_swings_as_theory_says_and_keeps_its_energy():
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
    after = []
    for robot in (nominal, other, same):
        dynamics = robot.dynamics
        assert dynamics is not None
        carry = dynamics.start(states[:, : dynamics.n_lags + 1], np.zeros((1, dynamics.n_lags, 1)), np.zeros((1, 0)))
        after.append(dynamics.step(carry, np.array([[0.3]])))
    assert np.array_equal(after[1], after[2])
    assert not np.allclose(after[0], after[1], rtol=1e-6)
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


@pytest.mark.parametrize("name", NAMES)
def test_a_recording_begins_where_it_is_let_go_repeats_and_ends_when_it_is_stopped(name):
    robot = find_robot(name)
    assert isinstance(robot, SensedRobot)
    first, again, other = (robot.record(seed=seed, duration=20.0).dataset for seed in (3, 3, 4))
    assert first.fingerprint == again.fingerprint != other.fingerprint
    assert first.system == robot.system
    assert len({round(float(episode.states[0, -1]), 2) for episode in first}) > 3


def test_a_rate_is_exact_for_a_cubic_and_repeats_at_the_ends():
    time = 0.1 * np.arange(9)
    found = rate(time**3, 0.1)
    np.testing.assert_allclose(found[2:-2], 3.0 * time[2:-2] ** 2, atol=1e-12)
    assert found[0] == found[1] == found[2]
    assert not rate(np.ones(3), 0.1).any()
