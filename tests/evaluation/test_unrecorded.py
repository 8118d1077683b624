"""What to record next: the boxes in which controllers are most often outside the data."""

import numpy as np
import pytest

from evaluation.exploitability import what_to_record
from sysid_evo.data import Trajectory
from sysid_evo.data.support import Support
from sysid_evo.system import Channel, System

SYSTEM = System(
    (Channel("speed", "m/s"),), (Channel("drive", levels=(-1.0, 1.0)), Channel("steer", "rad", -0.3, 0.3)), 0.1
)


def support():
    """Speeds from 0 to 1 m/s, whose standard deviation is 0.29, driven forwards and straight on."""
    speeds = np.linspace(0.0, 1.0, 300)[:, None]
    return Support.of(SYSTEM, speeds, np.tile([1.0, 0.0], (300, 1)))


def driven(speeds, drive=1.0, steer=0.0):
    states = np.array([*speeds, 0.0])[:, None]
    return Trajectory(states, np.tile([drive, steer], (len(speeds), 1)), 0.1)


def test_the_most_visited_box_outside_the_data_comes_first():
    regions = what_to_record(support(), [driven([0.5] * 60 + [1.7] * 30), driven([1.25] * 10)])
    assert [region.share for region in regions] == [0.3, 0.1]
    np.testing.assert_allclose(
        [regions[0].low[0], regions[0].high[0]], [1.6, 1.8], err_msg="0.2 wide, at round numbers"
    )
    np.testing.assert_allclose([regions[1].low[0], regions[1].high[0]], [1.2, 1.4])
    assert regions[0].sentence == "speed 1.6 to 1.8 m/s, drive 1, steer -0.1 to 0.1 rad: 30 % of the steps"


def test_a_command_that_was_not_given_at_a_known_speed_is_outside():
    backwards, turning = driven([0.5] * 50, drive=-1.0), driven([0.5] * 50, steer=0.25)
    first, second = what_to_record(support(), [backwards, turning, backwards])
    assert first.low[1] == first.high[1] == -1.0
    np.testing.assert_allclose([second.low[2], second.high[2]], [0.1, 0.3])


def test_driving_within_the_data_or_not_at_all_asks_for_nothing():
    assert what_to_record(support(), [driven([0.1, 0.9])]) == ()
    assert what_to_record(support(), []) == ()


def test_no_more_regions_are_told_than_asked_for_and_no_rare_ones():
    speeds = [2.0 + 0.2 * i for i in range(20) for _ in range(20 - i)]
    assert len(what_to_record(support(), [driven(speeds)], most=3)) == 3
    assert what_to_record(support(), [driven([0.5] * 9999 + [3.0])]) == ()


@pytest.mark.parametrize("angle", [3.0, 3.0 + 2.0 * np.pi])
def test_an_angle_that_comes_round_is_as_near_as_it_is_on_the_circle(angle):
    pendulum = System((Channel("angle", "rad", period=2.0 * np.pi),), (Channel("torque", "N m", -1.0, 1.0),), 0.1)
    angles = np.linspace(-0.5, 0.5, 100)[:, None]
    seen = Support.of(pendulum, angles, np.zeros((100, 1)))
    inside = Trajectory(np.full((5, 1), 0.2 + 2.0 * np.pi), np.zeros((4, 1)), 0.1)
    outside = Trajectory(np.full((5, 1), angle), np.zeros((4, 1)), 0.1)
    (region,) = what_to_record(seen, [inside, outside])
    assert region.share == 0.5
    assert region.high[0] - region.low[0] == pytest.approx(np.pi / 6.0)
