"""The emulated car on the host's clock."""

import numpy as np
import pytest

from hardware.emulation.cars import emulated_car
from tests.system.rig.moving_car import MOST_BEHIND, MovingCar

FORWARD = np.array([1.0, 0.0])


def test_in_real_time_it_is_the_car_of_simulated_time():
    moving, simulated = MovingCar(emulated_car(), seed=3, start=50.0), emulated_car().connect(seed=3)
    simulated.send(FORWARD, valid_for=100.0)
    for now in 50.0 + 0.005 * np.arange(200):
        for frame in moving.move(now + 1e-6, FORWARD):
            expected = simulated.measure(1.0)
            assert expected is not None
            np.testing.assert_array_equal(frame.pose, expected.pose)
            assert frame.source_time == pytest.approx(50.0 + expected.source_time)
            assert frame.arrival_time == pytest.approx(50.0 + expected.arrival_time)
    assert moving.frames == 200


def test_missed_steps_are_caught_up():
    moving = MovingCar(emulated_car(), seed=3, start=50.0)
    assert len(list(moving.move(50.5001, FORWARD))) == 101
    assert moving.lateness == pytest.approx(0.5001)
    assert moving.due == pytest.approx(50.505)


def test_a_process_that_slept_goes_on_from_now():
    moving = MovingCar(emulated_car(), seed=3, start=50.0)
    list(moving.move(50.0, FORWARD))
    frames = list(moving.move(50.0 + 100.0 * MOST_BEHIND, FORWARD))
    assert len(frames) <= 2
    assert frames[-1].source_time == pytest.approx(50.0 + 100.0 * MOST_BEHIND, abs=0.006)
    assert moving.given_up == pytest.approx(100.0 * MOST_BEHIND / 0.005, abs=2)
