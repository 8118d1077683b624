"""Preparation of pose logs, against motions whose velocities are known."""

import numpy as np
import pytest
import scipy

from sysid_evo.data import Dataset, RawLog, prepare, rows_as_episodes
from sysid_evo.data.preparation import CUTOFF, REACH, at_control_rate, low_pass
from sysid_evo.errors import InvalidArgument, InvalidData, ShapeError
from sysid_evo.motion import PlanarBody
from sysid_evo.system import Channel, System


@pytest.fixture
def logged_car(car):
    """The toy car with controls that may take any value, so that a log can number its rows in them."""
    return System(car.states, (Channel("drive"), Channel("steer")), car.dt, car.motion)


def first_tick(rate=200.0, dt=0.05):
    """The first tick that has half a filter before it."""
    margin = REACH + len(low_pass(CUTOFF / dt, rate, 0.5 / dt)) // 2
    return -(-margin // round(rate * dt))


def phasor(values, time, frequency):
    """Return mean, amplitude and phase (rad) of a sinusoid of known frequency, by least squares."""
    angle = 2.0 * np.pi * frequency * time
    mean, sine, cosine = np.linalg.lstsq(
        np.stack([np.ones_like(angle), np.sin(angle), np.cos(angle)], axis=1), values, rcond=None
    )[0]
    return mean, np.hypot(sine, cosine), np.arctan2(cosine, sine)


@pytest.mark.parametrize("rate", [100.0, 200.0])
@pytest.mark.parametrize("frequency, low, high", [(0.5, 0.995, 1.005), (2.0, 0.995, 1.005), (3.0, 0.955, 0.975)])
def test_a_known_motion_is_recovered_without_delay_and_with_the_stated_amplitude(
    make_drive, logged_car, rate, frequency, low, high
):
    drive = make_drive(rate=rate, frequency=frequency)
    (episode,) = prepare(drive.log(), logged_car).episodes
    time = (first_tick(rate) + np.arange(len(episode) + 1)) * 0.05
    truth = drive.velocity(time)
    for i in range(3):
        mean, amplitude, phase = phasor(episode.states[:, i], time, frequency)
        true_mean, true_amplitude, true_phase = phasor(truth[:, i], time, frequency)
        delay = (np.angle(np.exp(1j * (phase - true_phase)))) / (2.0 * np.pi * frequency)
        assert mean == pytest.approx(true_mean, abs=1e-3)
        assert low < amplitude / true_amplitude < high
        assert abs(delay) < 1e-4


@pytest.mark.parametrize("rate", [100.0, 200.0])
def test_the_low_pass_has_the_gains_its_docstring_states(rate):
    taps = low_pass(6.0, rate, 10.0)
    assert len(taps) % 2 == 1
    np.testing.assert_allclose(taps, taps[::-1], atol=1e-15)
    frequency = np.array([0.0, 2.0, 3.0, 4.0, 6.0, *np.linspace(10.0, rate / 2, 200)])
    gain = np.abs(scipy.signal.freqz(taps, 1, frequency, fs=rate)[1])
    np.testing.assert_allclose(gain[:5], [1.0, 1.0, 0.965, 0.87, 0.5], atol=5e-3)
    assert gain[5:].max() < 0.004


@pytest.mark.parametrize("cutoff", [1.0, 6.0])
def test_a_steady_turn_is_exact_whatever_the_cutoff(logged_car, cutoff):
    speed, yaw_rate, slip = 2.0, 4.0, 0.3
    time = np.arange(1201) / 200.0
    heading = yaw_rate * time
    course = heading + slip
    pose = np.stack([speed / yaw_rate * np.sin(course), -speed / yaw_rate * np.cos(course), heading], axis=1)
    wrapped = np.column_stack([pose[:, :2], np.arctan2(np.sin(heading), np.cos(heading))])
    (episode,) = prepare(RawLog("turn", time, wrapped, np.zeros((1201, 2))), logged_car, cutoff=cutoff).episodes
    expected = [speed * np.cos(slip), speed * np.sin(slip), yaw_rate]
    np.testing.assert_allclose(episode.states, np.tile(expected, (len(episode) + 1, 1)), rtol=1e-6)
    assert np.ptp(episode.pose[:, 2]) == pytest.approx(yaw_rate * episode.duration)


def test_moving_to_the_left_of_the_heading_is_a_positive_lateral_speed(logged_car):
    time = np.arange(401) / 200.0
    pose = np.stack([-0.5 * time, np.zeros(401), np.full(401, np.pi / 2)], axis=1)
    (episode,) = prepare(RawLog("left", time, pose, np.zeros((401, 2))), logged_car).episodes
    np.testing.assert_allclose(episode.states, np.tile([0.0, 0.5, 0.0], (len(episode) + 1, 1)), atol=1e-12)


def test_controls_are_those_of_the_row_at_each_tick_and_never_between(make_drive, logged_car):
    (episode,) = prepare(make_drive().log(), logged_car).episodes
    rows = 10.0 * (first_tick() + np.arange(len(episode)))
    np.testing.assert_array_equal(episode.controls[:, 0], rows)


def test_a_command_that_changes_between_ticks_is_held_from_the_next_tick_on(make_drive, logged_car):
    drive = make_drive()
    log = drive.log()
    switch = 1.0 * (drive.time >= 2.02)
    log = RawLog(log.name, log.time, log.pose, np.stack([switch, switch], axis=1))
    (episode,) = prepare(log, logged_car).episodes
    ticks = (first_tick() + np.arange(len(episode))) * 0.05
    np.testing.assert_array_equal(episode.controls[:, 0], ticks > 2.01)
    assert set(np.unique(episode.controls)) == {0.0, 1.0}


def test_the_pose_is_that_of_the_ticks(make_drive, logged_car):
    drive = make_drive()
    (episode,) = prepare(drive.log(), logged_car).episodes
    first = 10 * first_tick()
    np.testing.assert_allclose(episode.pose, drive.pose[first::10][: len(episode) + 1], atol=1e-12)


def test_stamps_that_scatter_around_a_steady_clock_do_no_harm(make_drive, logged_car, rng):
    drive = make_drive(rate=100.0)
    stamps = drive.time + rng.normal(0.0, 3e-4, len(drive.time))
    straight = prepare(drive.log(), logged_car).episodes[0]
    prepared = prepare(drive.log(stamps=stamps), logged_car)
    assert any("scatter" in note and "steady clock, which is used" in note for note in prepared.notes)
    np.testing.assert_allclose(prepared.episodes[0].states, straight.states, atol=2e-3)
    np.testing.assert_array_equal(prepared.episodes[0].controls, straight.controls)


def test_a_tracker_with_real_jitter_is_interpolated_with_a_note(make_drive, logged_car, rng):
    fine = make_drive(rate=4000.0, frequency=0.5)
    rows = 40 * np.arange(601) + np.concatenate([[0], rng.integers(-4, 5, 599), [0]])
    log = RawLog("jitter", fine.time[rows], fine.pose[rows], np.zeros((601, 2)))
    prepared = prepare(log, logged_car)
    assert any("interpolated linearly" in note for note in prepared.notes)
    (episode,) = prepared.episodes
    truth = fine.velocity((first_tick(100.0) + np.arange(len(episode) + 1)) * 0.05)
    assert np.abs(episode.states - truth).max() < 0.02


def test_a_gap_splits_the_log_into_parts_named_after_it(make_drive, logged_car):
    drive = make_drive(frequency=0.5)
    keep = np.concatenate([np.arange(0, 500), np.arange(533, 1201)])
    prepared = prepare(drive.log(keep=keep), logged_car)
    assert [episode.name for episode in prepared.episodes] == ["drive[4:46]", "drive[58:116]"]
    assert any("split at 1 gaps" in note for note in prepared.notes)
    for episode, first in zip(prepared.episodes, (4, 58), strict=True):
        ticks = first + np.arange(len(episode) + 1)
        np.testing.assert_array_equal(episode.controls[:, 0], 10.0 * ticks[:-1])
        assert np.abs(episode.states - drive.velocity(0.05 * ticks)).max() < 0.01
    other = prepare(drive.log(name="other"), logged_car).episodes
    rest, held_back = Dataset(logged_car, (*prepared.episodes, *other)).split(["drive"])
    assert held_back.names == ("drive[4:46]", "drive[58:116]")
    assert rest.names == ("other",)


def test_a_short_gap_is_bridged_with_a_note(make_drive, logged_car):
    drive = make_drive(frequency=0.5)
    keep = np.delete(np.arange(1201), [600, 601, 602])
    prepared = prepare(drive.log(keep=keep), logged_car)
    (episode,) = prepared.episodes
    assert episode.name == "drive"
    assert any("1 gaps of up to 20 ms bridged" in note for note in prepared.notes)
    truth = drive.velocity((first_tick() + np.arange(len(episode) + 1)) * 0.05)
    assert np.abs(episode.states - truth).max() < 0.02
    assert len(prepare(drive.log(keep=keep), logged_car, max_gap=0.01).episodes) == 2


def test_nothing_is_made_up_beyond_the_ends_of_the_log(make_drive, logged_car):
    (episode,) = prepare(make_drive(seconds=3.0).log(), logged_car).episodes
    margin = (REACH + len(low_pass(6.0, 200.0, 10.0)) // 2) / 200.0
    assert first_tick() * 0.05 >= margin
    assert (first_tick() + len(episode)) * 0.05 <= 3.0 - margin


def test_a_state_that_the_log_carries_is_filtered_and_not_derived(make_drive, logged_car):
    drive = make_drive()
    log = drive.log()
    battery = System(
        (*logged_car.states, Channel("battery", "V")), logged_car.controls, logged_car.dt, logged_car.motion
    )
    log = RawLog(log.name, log.time, log.pose, log.controls, {"battery": 7.0 + 0.1 * log.time})
    (episode,) = prepare(log, battery).episodes
    ticks = (first_tick() + np.arange(len(episode) + 1)) * 0.05
    np.testing.assert_allclose(episode.states[:, 3], 7.0 + 0.1 * ticks, atol=1e-9)
    with pytest.raises(InvalidData, match="'battery' is neither a velocity of the pose nor"):
        prepare(drive.log(), battery)


def test_a_body_without_a_lateral_state_gets_the_other_two(make_drive, logged_car):
    tracked = System(
        (Channel("yaw_rate"), Channel("forward_speed")), logged_car.controls, 0.05, PlanarBody(lateral=None)
    )
    log = make_drive().log()
    two, three = prepare(log, tracked).episodes[0], prepare(log, logged_car).episodes[0]
    np.testing.assert_array_equal(two.states, three.states[:, [2, 0]])


def test_logs_that_cannot_be_prepared_are_refused_with_the_reason(make_drive, logged_car):
    with pytest.raises(InvalidData, match=r"at least 3 rows for each control period of 0\.05 s.*0\.05 s apart"):
        prepare(make_drive(rate=20.0).log(), logged_car)
    with pytest.raises(InvalidArgument, match="less than half the control rate, 10 Hz; got 12 Hz"):
        prepare(make_drive().log(), logged_car, cutoff=12.0)
    with pytest.raises(InvalidData, match=r"expected more than 0\.44 s"):
        prepare(make_drive(seconds=0.4).log(), logged_car)
    log = make_drive().log()
    with pytest.raises(
        ShapeError, match="expected 2 controls and 3 pose coordinates, those of the system, got 1 and 3"
    ):
        prepare(RawLog("one", log.time, log.pose, log.controls[:, :1]), logged_car)
    with pytest.raises(InvalidData, match="rising time stamps"):
        prepare(RawLog("back", log.time[::-1], log.pose, log.controls), logged_car)


def log_with(time, car, rng):
    n = len(time)
    states = {name: rng.normal(size=n) for name in car.state_names}
    return RawLog("log", np.asarray(time), rng.normal(size=(n, 3)), rng.integers(-1, 2, (n, 2)).astype(float), states)


def test_samples_are_the_rows_and_the_clock_is_the_system_s(car, rng):
    log = log_with(0.05 * np.arange(40) + rng.uniform(-0.004, 0.004, 40), car, rng)
    (episode,) = rows_as_episodes(log, car).episodes
    assert (episode.name, episode.dt, len(episode)) == ("log", 0.05, 39)
    np.testing.assert_array_equal(episode.states, np.stack([log.extra[name] for name in car.state_names], axis=1))
    np.testing.assert_array_equal(episode.controls, log.controls[:-1])
    np.testing.assert_array_equal(episode.pose[:, :2], log.pose[:, :2])


def test_the_measured_steps_are_in_a_note(car, rng):
    steps = np.array([0.05, 0.047, 0.056, 0.05])
    (note,) = rows_as_episodes(log_with(np.concatenate([[0.0], np.cumsum(steps)]), car, rng), car).notes
    assert "every 50 ms" in note
    assert "47.0 to 56.0 ms apart (mean 50.75 ms)" in note
    (note,) = rows_as_episodes(log_with(0.05 * np.arange(20), car, rng), car).notes
    assert note == "rows taken as samples every 50 ms"


def test_a_lost_row_splits_the_log_and_a_lone_row_is_left_out(car, rng):
    time = 0.05 * np.delete(np.arange(30), [10, 20, 22])
    log = log_with(time, car, rng)
    prepared = rows_as_episodes(log, car)
    assert [episode.name for episode in prepared.episodes] == ["log[0:9]", "log[10:18]", "log[20:26]"]
    assert "3 steps outside 25 to 75 ms split it into 3 parts; 1 single rows left out" in prepared.notes[1]
    for episode, first, last in zip(prepared.episodes, (0, 10, 20), (9, 18, 26), strict=True):
        np.testing.assert_array_equal(episode.states[:, 0], log.extra["forward_speed"][first : last + 1])
        np.testing.assert_array_equal(episode.controls, log.controls[first:last])


@pytest.mark.parametrize("step, taken", [(0.041, True), (0.05, True), (0.059, True), (0.039, False), (0.061, False)])
def test_rows_within_a_fifth_of_the_control_rate_are_samples(car, rng, step, taken):
    log = log_with(step * np.arange(20), car, rng)
    assert at_control_rate(log, car) is taken
    assert not at_control_rate(RawLog("pose", log.time, log.pose, log.controls), car)


def test_a_log_without_the_states_is_refused(car, rng):
    log = log_with(0.05 * np.arange(20), car, rng)
    with pytest.raises(InvalidData, match="forward_speed, lateral_speed, yaw_rate are not among the columns"):
        rows_as_episodes(RawLog("pose", log.time, log.pose, log.controls), car)
