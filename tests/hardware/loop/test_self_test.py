"""Looking at a robot without moving it."""

import pytest

from hardware.self_test import self_test
from sysid_evo.registry import make_robot
from tests.hardware.loop.through import FaultyRobot


@pytest.fixture
def robot():
    return make_robot("emulated_car")


def what_is_wrong(robot, **faults):
    return {finding.what for finding in self_test(FaultyRobot(robot, **faults), seconds=1.0, seed=1) if not finding.ok}


def test_sound_robot_has_nothing_wrong_and_is_closed(robot):
    sound = FaultyRobot(robot)
    findings = self_test(sound, seconds=1.0, seed=1)
    assert all(finding.ok for finding in findings)
    assert sound.connection is not None
    assert sound.connection.closed
    assert not sound.connection.driven, "nothing but neutral was sent"


@pytest.mark.parametrize(
    ("faults", "wrong"),
    [
        ({"moved": (0.5, (0.05, 0.0, 0.0))}, {"tracker", "loop"}),
        ({"lost": (0.3, 0.5)}, {"tracker"}),
        ({"lost": (-1.0, 99.0)}, {"tracker", "loop"}),
        ({"broken_at": 0.5}, {"loop"}),
        ({"tripped_at": 0.5}, {"loop"}),
        ({"slow": {0.5: 30}}, {"loop"}),
    ],
)
def test_each_fault_is_found_where_it_is(robot, faults, wrong):
    assert what_is_wrong(robot, **faults) == wrong
