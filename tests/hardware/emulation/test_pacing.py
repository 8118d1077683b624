"""Simulated sessions on the host's clock."""

import time

import numpy as np
import pytest

from hardware.emulation.simulated_robot import PacedRobot, in_real_time
from hardware.emulation.tracked_robots import TRACKER_DELAY
from sysid_evo.errors import LinkLost
from sysid_evo.registry import make_robot

PERIOD = 0.005


def test_frames_come_when_they_are_due_and_keep_their_times():
    with in_real_time(make_robot("emulated_car")).connect(seed=1) as connection:
        for _ in range(40):
            frame = connection.measure(1.0)
            assert frame is not None
            assert connection.time >= frame.arrival_time == pytest.approx(frame.source_time + TRACKER_DELAY)
        began = frame.source_time - 39 * PERIOD
        assert connection.time - began >= 39 * PERIOD + TRACKER_DELAY


def test_whoever_calls_late_finds_every_frame_of_the_time_in_between():
    with in_real_time(make_robot("emulated_car")).connect(seed=1) as connection:
        time.sleep(0.2)
        deadline = connection.time
        numbers = []
        while (frame := connection.measure(0.0)) is not None and frame.arrival_time <= deadline:
            numbers.append(frame.frame)
        assert numbers == list(range(len(numbers)))
        assert len(numbers) >= 0.19 / PERIOD


def test_a_command_is_in_force_no_longer_than_it_is_valid_however_late_the_next_call():
    paced, simulated = (
        robot.connect(seed=3) for robot in (PacedRobot(make_robot("emulated_car")), make_robot("emulated_car"))
    )
    with paced, simulated:
        forward = np.array([1.0, 0.0])
        first = paced.measure(1.0)
        time.sleep(0.3)
        paced.send(forward, valid_for=0.15)
        sent_after = paced.simulated.frame
        assert sent_after * PERIOD > 0.29
        for _ in range(sent_after + 1):
            simulated.measure(1.0)
        simulated.send(forward, valid_for=0.15)
        time.sleep(0.6)
        while (late := paced.measure(0.0)) is not None and late.frame < 170:
            pass
        while (wanted := simulated.measure(1.0)).frame < 170:
            pass
        assert late is not None
        np.testing.assert_array_equal(late.pose, wanted.pose)
        assert np.hypot(*(late.pose - first.pose)[:2]) > 0.02
        assert not paced.simulated.control.any()


def test_nothing_within_the_timeout_is_none_and_a_closed_session_is_lost():
    connection = in_real_time(make_robot("emulated_car")).connect(seed=1)
    time.sleep(0.02)
    while connection.measure(0.0) is not None:
        pass
    time.sleep(0.02)
    connection.close()
    with pytest.raises(LinkLost, match="closed"):
        connection.measure(0.0)


def test_a_robot_on_the_hosts_clock_stays_as_it_is():
    paced = in_real_time(make_robot("emulated_car"))
    assert in_real_time(paced) is paced
    assert (paced.name, paced.system.dt) == ("emulated_car", 0.05)
