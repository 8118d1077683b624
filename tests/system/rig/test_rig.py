"""What the fail-safes are judged by: when buttons opened in the journal of the rig, and its car in real time."""

import numpy as np
import pytest

from hardware.emulation.cars import emulated_car
from tests.system.rig.journal import Entry, buttons_at, opened_after
from tests.system.rig.moving_car import MOST_BEHIND, MovingCar

FORWARD = np.array([1.0, 0.0])
PRESSES = [Entry(1.0, "buttons", 1), Entry(2.0, "buttons", 5), Entry(3.0, "buttons", 0), Entry(3.5, "out", "00")]


def test_buttons_are_found_for_any_time_and_when_they_open_for_good():
    assert [buttons_at(PRESSES, time) for time in (0.5, 1.0, 2.5, 9.0)] == [0, 1, 5, 0]
    assert [opened_after(PRESSES, time) for time in (0.5, 2.5, 4.0)] == [3.0, 3.0, 4.0]
    assert opened_after([*PRESSES, Entry(5.0, "buttons", 2)], 4.0) is None
    assert opened_after(PRESSES[:2], 1.5) is None


def test_in_real_time_it_is_the_car_of_simulated_time():
    moving, simulated = MovingCar(emulated_car(), seed=3, start=50.0), emulated_car().connect(seed=3)
    simulated.send(FORWARD, valid_for=100.0)
    for now in 50.0 + 0.005 * np.arange(200):
        for frame in moving.move(now + 1e-6, FORWARD):
            expected = simulated.measure(1.0)
            np.testing.assert_array_equal(frame.pose, expected.pose)
            assert frame.source_time == pytest.approx(50.0 + expected.source_time)
            assert frame.arrival_time == pytest.approx(50.0 + expected.arrival_time)
    assert moving.frames == 200


def test_missed_steps_are_caught_up_and_a_process_that_slept_goes_on_from_now():
    moving = MovingCar(emulated_car(), seed=3, start=50.0)
    assert (len(list(moving.move(50.5001, FORWARD))), moving.lateness) == (101, pytest.approx(0.5001))
    assert moving.due == pytest.approx(50.505)
    slept = MovingCar(emulated_car(), seed=3, start=50.0)
    list(slept.move(50.0, FORWARD))
    frames = list(slept.move(50.0 + 100.0 * MOST_BEHIND, FORWARD))
    assert len(frames) <= 2
    assert frames[-1].source_time == pytest.approx(50.0 + 100.0 * MOST_BEHIND, abs=0.006)
    assert slept.given_up == pytest.approx(100.0 * MOST_BEHIND / 0.005, abs=2)
