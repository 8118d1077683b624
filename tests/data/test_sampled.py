"""Logs at the control rate, taken row by row."""

import numpy as np
import pytest

from sysid_evo.data import RawLog, take_rows
from sysid_evo.data.preparation import at_control_rate
from sysid_evo.errors import InvalidData


def log_with(time, car, rng):
    n = len(time)
    states = {name: rng.normal(size=n) for name in car.state_names}
    return RawLog("log", np.asarray(time), rng.normal(size=(n, 3)), rng.integers(-1, 2, (n, 2)).astype(float), states)


def test_samples_are_the_rows_and_the_clock_is_the_system_s(car, rng):
    log = log_with(0.05 * np.arange(40) + rng.uniform(-0.004, 0.004, 40), car, rng)
    (episode,) = take_rows(log, car).episodes
    assert (episode.name, episode.dt, len(episode)) == ("log", 0.05, 39)
    np.testing.assert_array_equal(episode.states, np.stack([log.extra[name] for name in car.state_names], axis=1))
    np.testing.assert_array_equal(episode.controls, log.controls[:-1])
    np.testing.assert_array_equal(episode.pose[:, :2], log.pose[:, :2])


def test_the_measured_steps_are_told(car, rng):
    steps = np.array([0.05, 0.047, 0.056, 0.05])
    (note,) = take_rows(log_with(np.concatenate([[0.0], np.cumsum(steps)]), car, rng), car).notes
    assert "every 50 ms" in note
    assert "47.0 to 56.0 ms apart (mean 50.75 ms)" in note
    (note,) = take_rows(log_with(0.05 * np.arange(20), car, rng), car).notes
    assert note == "rows taken as samples every 50 ms"


def test_a_lost_row_splits_the_log_and_a_lone_row_is_left_out(car, rng):
    time = 0.05 * np.delete(np.arange(30), [10, 20, 22])
    log = log_with(time, car, rng)
    prepared = take_rows(log, car)
    assert [episode.name for episode in prepared.episodes] == ["log[0:9]", "log[10:18]", "log[20:26]"]
    assert "3 steps outside 25 to 75 ms split it into 3 pieces; 1 single rows left out" in prepared.notes[1]
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
        take_rows(RawLog("pose", log.time, log.pose, log.controls), car)
