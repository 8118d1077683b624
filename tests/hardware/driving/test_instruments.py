"""What the page is told."""

import json

import numpy as np
import pytest

from hardware.control_loop import ControlLoop
from hardware.driving.hand_driving import HumanPilot, Instruments
from hardware.driving.page_messages import FORWARD
from sysid_evo.tasks import PointToPoint
from tests.hardware.driving.conftest import Hands


def test_a_reading_tells_pose_speed_score_and_the_health_of_the_tracker(emulated):
    hands = Hands(lambda time: FORWARD if time > 1.5 else 0)
    task = PointToPoint(horizon=100).bind(emulated.system)
    instruments = Instruments(emulated, task, hands.keyboard, clock=lambda: hands.time)
    json.dumps([instruments.setting(), instruments.reading()], allow_nan=False)
    pilot = HumanPilot(hands.keyboard, task, seed=1)
    with emulated.connect(seed=1) as connection:
        instruments.begin(pilot, 3)
        loop = ControlLoop(connection, emulated.system, listeners=(hands, instruments))
        loop.run(pilot, samples=60)
        true = connection.state, connection.pose
    reading = json.loads(json.dumps(instruments.reading(), allow_nan=False))
    assert (reading["trial"], reading["phase"], reading["keys"]) == (3, "driving", FORWARD)
    assert reading["speed"] == pytest.approx(true[0][0], abs=0.1)
    np.testing.assert_allclose(reading["pose"], true[1], atol=0.05)
    assert reading["tracker"]["rate"] == 200
    assert reading["time_left"] == pytest.approx(5.0 - (hands.time - 1.5), abs=0.15)
    assert reading["link"] is None
    instruments.finish(4.0, "the tracker lost the robot")
    reading = instruments.reading()
    assert (reading["scores"], reading["message"], reading["control"]) == ([4.0], "the tracker lost the robot", None)
