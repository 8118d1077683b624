"""The causal estimator against motions whose velocities are known."""

import numpy as np
import pytest

from hardware.connection import Measurement
from hardware.estimator import LAG, WINDOW, PoseEstimator, estimator_delays, measure_delays, synthetic_drive
from sysid_evo.errors import IncompatibleSystem
from sysid_evo.motion import PlanarBody
from sysid_evo.system import Channel, System

CAR = System(
    (Channel("forward_speed", "m/s"), Channel("lateral_speed", "m/s"), Channel("yaw_rate", "rad/s")),
    (Channel("drive", low=-1.0, high=1.0),),
    0.05,
    PlanarBody(),
)
SHUFFLED = System((Channel("r", "rad/s"), Channel("u", "m/s")), CAR.controls, 0.05, PlanarBody("u", None, "r"))


def seen(times, poses, system=CAR):
    """Return an estimator that was given all poses (T, 3)."""
    estimator = PoseEstimator(system)
    for frame, (time, pose) in enumerate(zip(times, poses, strict=True)):
        estimator.add(Measurement(time, time + 0.004, frame, "car", True, pose))
    return estimator


def estimated(times, poses, system=CAR):
    return seen(times, poses, system).estimate(times[-1]).state


def circle(times, speed=1.2, rate=2.0, start=3.0):
    """Return the poses of a body that drives a circle, heading along it, wrapped to [-pi, pi)."""
    heading = start + rate * times
    x, y = speed / rate * np.sin(heading), -speed / rate * np.cos(heading)
    return np.stack([x, y, np.remainder(heading + np.pi, 2 * np.pi) - np.pi], axis=1)


def test_constant_acceleration_is_followed_without_error_at_the_lag():
    t = 0.005 * np.arange(40)
    heading = 0.4
    along = 0.5 * t + 0.5 * 2.0 * t**2
    poses = np.stack([along * np.cos(heading), along * np.sin(heading), np.full_like(t, heading)], axis=1)
    state = estimated(t, poses)
    np.testing.assert_allclose(state, [0.5 + 2.0 * (t[-1] - LAG), 0.0, 0.0], atol=1e-9)


def test_circle_has_its_speeds_in_the_body_frame_across_the_wrap_of_the_heading():
    times = 0.005 * np.arange(60)
    for end in range(25, 60):
        state = estimated(times[:end], circle(times[:end]))
        np.testing.assert_allclose(state, [1.2, 0.0, 2.0], atol=0.01)


def test_sideways_motion_is_lateral_speed_to_the_left():
    times = 0.005 * np.arange(30)
    poses = np.stack([-0.3 * times, np.zeros(30), np.full(30, np.pi / 2)], axis=1)
    np.testing.assert_allclose(estimated(times, poses), [0.0, 0.3, 0.0], atol=1e-9)


def test_channels_are_where_the_motion_names_them():
    times = 0.005 * np.arange(40)
    np.testing.assert_allclose(estimated(times, circle(times), SHUFFLED), [2.0, 1.2], atol=0.01)


def test_uneven_frames_and_a_slow_tracker_do_not_bias_the_estimate(rng):
    times = np.cumsum(rng.uniform(0.002, 0.012, 60))
    np.testing.assert_allclose(estimated(times, circle(times)), [1.2, 0.0, 2.0], atol=0.02)
    times = np.arange(12) / 50.0
    np.testing.assert_allclose(estimated(times, circle(times)), [1.2, 0.0, 2.0], atol=0.02)


def test_noise_is_damped_to_what_the_window_allows(rng):
    """The variance of the slope of a parabola at -lag, by its normal equations, times that of the poses."""
    times, sigma = 0.005 * np.arange(40), np.array([0.001, 0.001, 0.005])
    found = np.array([estimated(times, rng.normal(0.0, sigma, (40, 3))) for _ in range(400)])
    t = times[times >= times[-1] - WINDOW - 1e-9] - times[-1]
    design = np.stack([np.ones_like(t), t, t * t], axis=1)
    slope = np.array([0.0, 1.0, -2.0 * LAG])
    factor = np.sqrt(slope @ np.linalg.solve(design.T @ design, slope))
    np.testing.assert_allclose(found.std(axis=0), factor * sigma, rtol=0.15)


def test_an_estimate_has_the_newest_pose_and_its_age():
    times = 0.005 * np.arange(40)
    poses = circle(times)
    found = seen(times, poses).estimate(times[-1] + 0.03)
    np.testing.assert_allclose(found.pose[:2], poses[-1, :2])
    assert np.remainder(found.pose[2] - poses[-1, 2] + 1.0, 2 * np.pi) == pytest.approx(1.0)
    assert found.age == pytest.approx(0.03)


def test_nothing_is_known_before_the_window_is_covered_and_after_a_restart():
    times = 0.005 * np.arange(40)
    assert seen(times[:12], circle(times[:12])).estimate(times[11]) is None
    estimator = seen(times, circle(times))
    estimator.restart()
    assert estimator.estimate(times[-1]) is None


def test_restart_keeps_a_jump_out_of_the_speeds():
    times = 0.005 * np.arange(80)
    poses = circle(times)
    poses[40:, 0] += 5.0
    estimator = seen(times[:40], poses[:40])
    estimator.restart()
    for frame in range(40, 80):
        estimator.add(Measurement(times[frame], times[frame], frame, "car", True, poses[frame]))
        found = estimator.estimate(times[frame])
        if found is not None:
            np.testing.assert_allclose(found.state, [1.2, 0.0, 2.0], atol=0.01)
    assert found is not None


def test_pose_that_is_not_newer_is_left_out():
    times = 0.005 * np.arange(40)
    estimator = seen(times, circle(times))
    estimator.add(Measurement(times[-2], times[-1], 99, "car", True, np.full(3, 50.0)))
    np.testing.assert_allclose(estimator.estimate(times[-1]).state, [1.2, 0.0, 2.0], atol=0.01)


def test_dropout_of_90_ms_leaves_an_estimate_at_every_frame_after_it():
    times = 0.005 * np.arange(100)
    times = times[(times <= 0.2) | (times > 0.29)]
    for end in range(45, len(times)):
        np.testing.assert_allclose(estimated(times[:end], circle(times[:end])), [1.2, 0.0, 2.0], atol=0.1)


@pytest.mark.parametrize("frame_interval", [0.005, 0.01])
def test_measured_delay_is_the_lag(frame_interval):
    for delay in estimator_delays(CAR, frame_interval=frame_interval):
        assert delay == pytest.approx(LAG, abs=0.001)


def test_delay_of_a_shifted_truth_is_the_shift():
    times = 0.005 * np.arange(4000)
    states, poses = synthetic_drive(CAR, times)
    assert np.abs(poses).max() > 0.3
    asked = 0.3 + 0.05 * np.arange(350)
    shifts = (0.0, 0.0123, 0.15)
    columns = [np.interp(asked - shift, times, states[:, i]) for i, shift in enumerate(shifts)]
    found = measure_delays(CAR, times, states, asked, np.stack(columns, axis=1))
    np.testing.assert_allclose(found, shifts, atol=2e-4)


def test_systems_that_poses_do_not_determine_are_refused():
    with pytest.raises(IncompatibleSystem, match="no motion"):
        PoseEstimator(System((Channel("x"),), (Channel("u"),), 0.05))
    with pytest.raises(IncompatibleSystem, match="battery"):
        PoseEstimator(System((*CAR.states, Channel("battery")), CAR.controls, 0.05, PlanarBody()))
