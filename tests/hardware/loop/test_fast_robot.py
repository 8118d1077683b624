"""A robot that is faster than the gate believes: lost with the reason and the key, found once its file says so."""

import re

import numpy as np

from hardware.connection import GateLimits
from hardware.emulation.tracked_robots import EmulatedRobot
from hardware.recording.journal import read_journal
from hardware.recording.manoeuvres import Manoeuvre
from hardware.recording.record import record
from hardware.run_report import Reason
from sysid_evo.models import Dynamics
from sysid_evo.motion import PlanarBody
from sysid_evo.system import Channel, System


class Sled(Dynamics):
    """Goes straight, up to 12 m/s, to where the throttle says with a lag of 0.3 s."""

    system = System(
        (Channel("forward_speed", "m/s"), Channel("yaw_rate", "rad/s")),
        (Channel("throttle", low=-1.0, high=1.0),),
        dt=0.005,
        motion=PlanarBody(lateral=None),
    )
    n_carry = 2

    def start(self, states, controls, draws=None):
        return states[:, -1].copy()

    def step(self, carry, control, noise=None):
        speed = carry[:, 0] + (12.0 * control[:, 0] - carry[:, 0]) * self.system.dt / 0.3
        return np.stack([speed, carry[:, 1]], axis=1)


def driven(folder, gate):
    robot = EmulatedRobot("sled", Sled(), repeats=10, gate=gate)
    return record(robot, [Manoeuvre("away", np.ones((40, 1)))], folder, seed=1)


def test_a_robot_that_is_too_fast_for_the_gate_is_lost_with_its_speed_the_limit_and_the_key(tmp_path):
    report = driven(tmp_path, None)
    assert report.reason is Reason.TRACKER_LOST
    assert "the newest pose is 0.5" in report.detail
    seen = re.search(
        r"it moves at ([\d.]+) m/s, and a frame is believed up to speed = 5 m/s; .* \[gate\]", report.detail
    )
    assert seen is not None
    assert 7.0 < float(seen[1]) < 12.0


def test_the_same_robot_is_seen_once_its_limits_say_how_fast_it_is_and_the_journal_remembers_them(tmp_path):
    report = driven(tmp_path, GateLimits(speed=15.0))
    assert (report.reason, report.rejected) == (Reason.PILOT, {})
    assert read_journal(tmp_path / "away.rcj").limits.speed == 15.0
