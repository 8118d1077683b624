"""The fine physics of the emulated car, against what mechanics says."""

from dataclasses import fields, replace

import numpy as np
import pytest

from hardware.emulation.car_physics import BODY, FINE_DT, LATENCY, CarParameters
from hardware.emulation.cars import AWKWARD, AwkwardCar, ToyCarDynamics
from hardware.emulation.held_control import HeldControl
from sysid_evo.errors import InvalidArgument
from sysid_evo.registry import make_robot
from tests.fixtures.by_hand import Delayed

MOTOR, SAG, BATTERY, SLACK, STEERING, FORCE_NOISE = range(BODY, BODY + 6)


@pytest.fixture(scope="module")
def car():
    return ToyCarDynamics()


def started(car, state=(0.0, 0.0, 0.0), past=(0, 0)):
    states = np.tile(np.array(state), (1, LATENCY + 1, 1))
    return car.start(states, np.tile(np.array(past, dtype=float), (1, LATENCY, 1)))


def held(car, carry, drive, steer, seconds, noise=None):
    """Return the carries (T + 1, n_carry) of the first row under one command."""
    control = np.tile([drive, steer], (len(carry), 1))
    rows = [carry[0]]
    for k in range(round(seconds / FINE_DT)):
        carry = car.step(carry, control, None if noise is None else noise[k])
        rows.append(carry[0])
    return np.array(rows)


@pytest.mark.parametrize("steer", [-1.0, 0.0, 1.0])
def test_car_at_rest_without_thrust_stays_exactly_at_rest(car, steer):
    assert np.all(held(car, started(car), 0.0, steer, 5.0)[:, :3] == 0.0)


def test_noise_however_strong_does_not_move_a_car_at_rest(rng):
    car = ToyCarDynamics(CarParameters(force_noise=50.0, yaw_noise=500.0))
    noise = rng.standard_normal((1000, 1, 2))
    path = held(car, car.start(np.zeros((1, 11, 3)), np.zeros((1, 10, 2)), np.full((1, 3), 3.0)), 0.0, 1.0, 5.0, noise)
    assert np.all(path[:, :3] == 0.0)
    assert path[:, FORCE_NOISE].std() > 20.0


def test_thrust_below_static_friction_does_not_move_the_car():
    weak, able = (ToyCarDynamics(CarParameters(thrust_forward=f, static_friction=0.9)) for f in (0.89, 1.1))
    assert np.all(held(weak, started(weak), 1.0, 0.0, 5.0)[:, :3] == 0.0)
    assert held(able, started(able), 1.0, 0.0, 5.0)[-1, 0] > 0.1


def test_coasting_ends_when_linear_drag_and_friction_predict_it():
    car = ToyCarDynamics(CarParameters(static_friction=0.5, steer_offset=1e-9, linkage_play=1e-9))
    speed, drag, resistance = 1.5, 0.6 + 0.15, 0.5
    path = held(car, started(car, (speed, 0.0, 0.0)), 0.0, 0.0, 4.0)[:, :3]
    expected = np.log1p(drag * speed / resistance) / drag
    stopped = np.argmax(path[:, 0] == 0.0) * FINE_DT
    assert stopped == pytest.approx(expected, rel=0.01)
    moving = path[:, 0][path[:, 0] > 0.0]
    assert np.all(np.diff(moving) < 0.0)
    assert np.all(path[round(stopped / FINE_DT) :] == 0.0)


@pytest.mark.parametrize("drive, speed", [(1.0, 2.0), (-1.0, 1.4)])
def test_top_speed_balances_thrust_against_back_emf_and_rolling_and_is_that_of_the_calibration(car, drive, speed):
    p = car.parameters
    thrust = p.thrust_forward if drive > 0.0 else p.thrust_backward
    expected = (thrust * (1.0 - p.sag) - p.rolling_resistance) / (p.back_emf + p.rolling_drag)
    straight = ToyCarDynamics(replace(p, steer_offset=1e-9, linkage_play=1e-9))
    assert held(straight, started(straight), drive, 0.0, 10.0)[-1, 0] == pytest.approx(drive * expected, rel=1e-3)
    assert held(car, started(car), drive, 0.0, 10.0)[-1, 0] == pytest.approx(drive * speed, rel=0.03)


@pytest.mark.parametrize("drive, steer, radius", [(1, 1, 0.60), (1, -1, 0.66), (-1, 1, 0.46), (-1, -1, 0.66)])
def test_turning_radius_is_that_of_the_calibration(car, drive, steer, radius):
    u, v, r = held(car, started(car), drive, steer, 10.0)[-1, :3]
    assert np.hypot(u, v) / abs(r) == pytest.approx(radius, rel=0.05)
    assert np.sign(r) == drive * steer


def test_slow_car_turns_as_its_wheels_point():
    smooth = dict.fromkeys(("static_friction", "rolling_resistance", "rolling_drag", "coasting_drag"), 1e-3)
    p = CarParameters(linkage_play=1e-9, **smooth)
    car = ToyCarDynamics(p)
    path = held(car, started(car, (0.25, 0.0, 0.0), (0.0, 1.0)), 0.0, 1.0, 0.5)[40:]
    angle = path[:, STEERING]
    assert angle == pytest.approx(p.steer_left + p.steer_offset, rel=1e-6)
    assert path[:, 2] == pytest.approx(path[:, 0] * np.tan(angle) / (p.front_axle + p.rear_axle), rel=0.02)
    assert path[:, 1] == pytest.approx(path[:, 2] * p.rear_axle, rel=0.1)


def test_spinning_without_thrust_stops_within_half_a_second(car):
    path = held(car, started(car, (0.0, 0.0, 8.0)), 0.0, 0.0, 1.0)
    assert np.all(path[100:, :3] == 0.0)
    assert np.all(np.diff(path[:, 2]) <= 0.0)


def test_car_sliding_sideways_stops_no_faster_than_its_tyres_allow(car):
    p = car.parameters
    path = held(car, started(car, (0.0, 1.0, 0.0)), 0.0, 0.0, 1.0)
    expected = 1.0 / ((p.front_grip + p.rear_grip) / p.mass)
    assert np.argmax(path[:, 1] < 0.02) * FINE_DT == pytest.approx(expected, abs=0.03)
    assert np.all(path[-1, :3] == 0.0)


def test_car_cannot_turn_on_the_spot(car, rng):
    batch, steps = 100, 1500
    carry = car.start(np.zeros((batch, 11, 3)), np.zeros((batch, 10, 2)), rng.standard_normal((batch, 3)))
    control = rng.integers(-1, 2, (batch, 2)).astype(float)
    states = np.empty((steps, batch, 3))
    for k in range(steps):
        jump = rng.random(batch) < 0.02
        control[jump] = rng.integers(-1, 2, (int(jump.sum()), 2))
        carry = car.step(carry, control, rng.standard_normal((batch, 2)))
        states[k] = carry[:, :3]
    slow = np.abs(states[..., 0]) < 0.1
    assert slow.sum() > 5_000
    assert np.abs(states[..., 2][slow]).max() < 1.0
    assert np.abs(states[..., 1]).max() < 0.35


def test_command_reaches_the_motor_after_exactly_ten_steps(car):
    path = held(car, started(car), 1.0, 1.0, 0.06)
    assert np.all(path[: LATENCY + 1, MOTOR] == 0.0)
    assert path[LATENCY + 1, MOTOR] > 0.0
    rest = started(car)[0, STEERING]
    assert np.all(path[: LATENCY + 1, STEERING] == rest)
    assert path[LATENCY + 1, STEERING] > rest


def test_motor_steering_and_sag_settle_with_their_lags(car):
    p = car.parameters
    path = held(car, started(car), 1.0, 1.0, 4.0)[LATENCY:]
    after = round(p.motor_lag / FINE_DT)
    assert path[after, MOTOR] == pytest.approx(1.0 - np.exp(-1.0), rel=1e-9)
    after = round(p.steering_lag / FINE_DT)
    share = (path[after, STEERING] - p.steer_offset) / p.steer_left
    assert share == pytest.approx(1.0 - np.exp(-1.0), rel=1e-9)
    assert path[-1, SAG] == pytest.approx(p.sag, rel=1e-3)


def test_thrust_after_a_reversal_waits_for_the_slack_to_close(car):
    def launch(slack):
        carry = started(car)
        carry[0, SLACK] = slack
        return int(np.argmax(held(car, carry, 1.0, 0.0, 1.0)[:, 0] > 0.0))

    assert 2 * round(car.parameters.slack_time / FINE_DT) >= launch(-1.0) - launch(1.0) >= 2


def test_thrust_takes_grip_from_the_rear_tyres(car):
    sure = ToyCarDynamics(replace(car.parameters, thrust_grip_loss=1e-6))
    loose = held(car, started(car), 1.0, 1.0, 10.0)[-1]
    firm = held(sure, started(sure), 1.0, 1.0, 10.0)[-1]
    assert loose[2] / loose[0] > 1.05 * firm[2] / firm[0]


def test_battery_is_uniform_within_eight_per_cent_and_sets_the_top_speed(car, rng):
    draws = rng.standard_normal((20_000, 3))
    level = car.start(np.zeros((20_000, 11, 3)), np.zeros((20_000, 10, 2)), draws)[:, BATTERY]
    assert np.abs(level - 1.0).max() <= 0.08
    assert level.std() == pytest.approx(0.08 / np.sqrt(3.0), rel=0.02)
    full, empty = (
        held(car, car.start(np.zeros((1, 11, 3)), np.zeros((1, 10, 2)), np.array([[z, 0.0, 0.0]])), 1, 0, 8.0)[-1, 0]
        for z in (5.0, -5.0)
    )
    assert full - empty == pytest.approx(0.16 * 3.2 / 1.23, rel=0.02)


def test_noise_is_stationary_and_forgets_within_its_lag(car, rng):
    p, batch = car.parameters, 4000
    carry = car.start(np.zeros((batch, 11, 3)), np.zeros((batch, 10, 2)), rng.standard_normal((batch, 3)))
    first = carry[:, FORCE_NOISE : FORCE_NOISE + 2]
    for _ in range(round(p.noise_lag / FINE_DT)):
        carry = car.step(carry, np.zeros((batch, 2)), rng.standard_normal((batch, 2)))
    last = carry[:, FORCE_NOISE : FORCE_NOISE + 2]
    for i, scale in enumerate((p.force_noise, p.yaw_noise)):
        assert first[:, i].std() == pytest.approx(scale, rel=0.05)
        assert last[:, i].std() == pytest.approx(scale, rel=0.05)
        assert np.corrcoef(first[:, i], last[:, i])[0, 1] == pytest.approx(np.exp(-1.0), abs=0.05)


def test_start_takes_the_oldest_command_for_one_held_long(car):
    long = held(car, started(car, (1.9, 0.0, 0.1)), 1.0, 1.0, 5.0)[-1]
    short = started(car, (1.9, 0.0, 0.1), (1.0, 1.0))[0]
    assert short[BODY:] == pytest.approx(long[BODY:], abs=1e-5)
    assert np.array_equal(short[3:BODY], long[3:BODY])


def test_perturbed_cars_differ_and_stay_within_their_spread():
    nominal = CarParameters()
    cars = [nominal.perturbed(seed) for seed in range(200)]
    assert cars[3] == nominal.perturbed(3)
    assert len(set(cars)) == len(cars)
    for item in fields(nominal):
        centre, spread = getattr(nominal, item.name), item.metadata["spread"]
        assert 0.1 <= spread <= 0.3
        if centre == 0.0:
            assert {getattr(car, item.name) for car in cars} == {0.0}
            continue
        ratios = np.array([getattr(car, item.name) for car in cars]) / centre - 1.0
        assert np.abs(ratios).max() <= spread + 1e-12
        assert np.ptp(ratios) > spread
        assert item.metadata["unit"]
        assert item.metadata["reason"]


def test_stiffest_car_within_the_spread_can_still_be_stepped():
    nominal, spread = CarParameters(), {item.name: item.metadata["spread"] for item in fields(CarParameters)}
    extreme = {n: 1.0 + spread[n] for n in ("front_grip", "rear_grip", "slip_gain", "front_axle", "rear_axle")}
    extreme |= {n: 1.0 - spread[n] for n in ("mass", "yaw_inertia", "slip_floor")}
    replace(nominal, **{name: getattr(nominal, name) * factor for name, factor in extreme.items()})


@pytest.mark.parametrize(
    "change, message",
    [
        ({"mass": 0.0}, "expected mass > 0 kg"),
        ({"sag": 1.2}, "sag is a share below 1"),
        ({"start_level": 1.0}, "start_level is a share below 1"),
        ({"thrust_backward": -0.1}, "expected thrust_backward >= 0 m/s2"),
        ({"static_friction": 0.3}, "expected static_friction >= rolling_resistance"),
        ({"slip_floor": 0.2}, "overshoot in steps of 0.005 s"),
    ],
)
def test_impossible_parameters_are_refused_by_name(change, message):
    with pytest.raises(InvalidArgument, match=message):
        CarParameters(**change)


SECOND = 200  # fine steps


def speeds(drive, parameters=AWKWARD):
    """Return the forward speed after each fine step from rest under ``drive`` (T,)."""
    car = ToyCarDynamics(parameters)
    carry = car.start(np.zeros((1, 11, 3)), np.zeros((1, 10, 2)))
    found = np.empty(len(drive))
    for k, value in enumerate(drive):
        carry = car.step(carry, np.array([[value, 0.0]]))
        found[k] = carry[0, 0]
    return found


def test_it_starts_only_after_drive_was_held_and_then_races_as_any_car():
    found, usual = (speeds(np.ones(3 * SECOND), parameters) for parameters in (AWKWARD, CarParameters()))
    assert found[: int(0.38 * SECOND)].max() == 0.0
    assert usual[: int(0.38 * SECOND)].max() > 0.3
    assert found[-1] == pytest.approx(usual[-1], rel=0.02)


def test_short_taps_of_the_drive_do_not_move_it():
    taps = np.tile(np.repeat([1.0, 0.0], [20, 60]), 10)  # 0.1 s in every 0.4 s
    assert speeds(taps).max() == 0.0
    assert speeds(taps, CarParameters()).max() > 0.1


def test_in_reverse_it_does_not_move_and_from_speed_it_brakes():
    assert not speeds(-np.ones(2 * SECOND)).any()
    launched = np.concatenate([np.ones(2 * SECOND), -np.ones(3 * SECOND)])
    coasting = np.concatenate([np.ones(2 * SECOND), np.zeros(3 * SECOND)])
    braked, free = speeds(launched), speeds(coasting)
    assert (braked >= 0.0).all()
    assert braked[int(2.5 * SECOND)] < free[int(2.5 * SECOND)]


def test_a_session_is_free_and_in_a_jammed_recording_the_car_does_not_move(tmp_path):
    car = make_robot("awkward_car(stuck=1.0)")
    assert isinstance(car, AwkwardCar)
    states = np.concatenate([one.states for one in car.record(seed=0, duration=30.0).dataset.episodes])
    assert np.abs(states[:, 0]).max() < 0.1
    with car.connect(seed=0) as link:
        for _ in range(3 * SECOND):
            link.send(np.array([1.0, 0.0]), valid_for=0.15)
            link.measure(1.0)
    assert np.hypot(*link.pose[:2]) > 1.0


def test_more_than_half_of_a_recording_is_useless():
    episodes = make_robot("awkward_car").record(seed=0, duration=36.0).dataset.episodes
    standing = np.concatenate([np.abs(one.states[:, 0]) < 0.05 for one in episodes])
    assert 0.5 < standing.mean() < 0.8


def test_stuck_is_a_share():
    with pytest.raises(InvalidArgument, match="stuck as a share up to 1"):
        make_robot("awkward_car(stuck=1.5)")
    with pytest.raises(InvalidArgument, match="stuck: expected a number of 0 or more, got -1"):
        make_robot("awkward_car(stuck=-1)")


def test_a_longer_lag_starts_later_and_a_seed_gives_another_car_without_reverse():
    other = make_robot("awkward_car:3").physics.parameters
    assert other.thrust_backward == 0.0
    assert other.start_speed != AWKWARD.start_speed
    usual, later = (make_robot(name).physics.parameters for name in ("awkward_car", "awkward_car(start_lag=1.5)"))
    drive = np.ones(2 * SECOND)
    starts = [int(np.argmax(speeds(drive, parameters) > 0.0)) for parameters in (usual, later)]
    assert starts[0] == pytest.approx((0.05 + 0.5 * np.log(2.0)) * SECOND, abs=4)
    assert starts[1] == pytest.approx((0.05 + 1.5 * np.log(2.0)) * SECOND, abs=4)


def test_coarse_step_equals_ten_fine_ones_exactly(rng):
    fine = ToyCarDynamics()
    coarse = HeldControl(fine, 10)
    draws = rng.standard_normal((20, 3))
    carry = coarse.start(np.zeros((20, 2, 3)), np.zeros((20, 1, 2)), draws)
    other = fine.start(np.zeros((20, 11, 3)), np.zeros((20, 10, 2)), draws)
    assert np.array_equal(carry, other)
    for _ in range(40):
        control = rng.integers(-1, 2, (20, 2)).astype(float)
        noise = rng.standard_normal((20, 20))
        carry = coarse.step(carry, control, noise)
        for k in range(10):
            other = fine.step(other, control, noise[:, 2 * k : 2 * k + 2])
        assert np.array_equal(carry, other)


def test_history_is_held_as_the_controls_are():
    fine = Delayed()
    coarse = HeldControl(fine, 2)
    assert (coarse.n_lags, coarse.n_noise, coarse.n_carry, coarse.system.dt) == (2, 2, 4, 0.02)
    carry = coarse.start(np.array([[[5.0], [6.0], [7.0]]]), np.array([[[0.1], [0.2]]]))
    assert carry[0].tolist() == [7.0, 0.1, 0.2, 0.2]
    with pytest.raises(InvalidArgument, match="at least one fine step"):
        HeldControl(fine, 0)


def test_any_fine_dynamics_can_be_held(rng):
    fine, steps = Delayed(), 5
    coarse = HeldControl(fine, 3)
    controls, noise = rng.uniform(-1, 1, (steps, 1, 1)), rng.standard_normal((steps, 1, 3))
    carry = coarse.start(np.ones((1, 2, 1)), np.zeros((1, 1, 1)))
    for k in range(steps):
        carry = coarse.step(carry, controls[k], noise[k])
    x, sent = 1.0, np.concatenate([np.zeros(3), np.repeat(controls.ravel(), 3)])
    for k in range(3 * steps):
        x = 0.9 * x + sent[k] + noise.ravel()[k]
    assert carry[0, 0] == pytest.approx(x)


def test_latency_is_exactly_one_sample():
    car = make_robot("emulated_car").dynamics
    carry = car.start(np.tile([1.0, 0.0, 0.0], (3, 2, 1)), np.tile([1.0, 0.0], (3, 1, 1)))
    carry = car.step(carry, np.array([[1.0, 0.0], [-1.0, 0.0], [1.0, 1.0]]))
    assert np.array_equal(carry[0, :3], carry[1, :3])
    assert np.array_equal(carry[0, :3], carry[2, :3])
    carry = car.step(carry, np.zeros((3, 2)))
    assert carry[1, 0] < carry[0, 0]
    assert carry[2, 2] > carry[0, 2]
