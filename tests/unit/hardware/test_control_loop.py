"""The control loop in simulated time, on the emulated car."""

import gc
import re

import numpy as np
import pytest

from hardware.connection import GateLimits
from hardware.control_loop import ControlLoop
from hardware.emulation.tracked_robots import EmulatedRobot
from hardware.recording.journal import read_journal
from hardware.recording.manoeuvres import Manoeuvre
from hardware.recording.record import record
from hardware.run_report import Reason
from sysid_evo.errors import InvalidArgument
from sysid_evo.models import Dynamics
from sysid_evo.motion import PlanarBody
from sysid_evo.registry import make_robot
from sysid_evo.system import Channel, System
from tests.fixtures.loop import Diary, FaultyRobot, Script

FORWARD = np.array([1.0, 0.0])


@pytest.fixture
def robot():
    return make_robot("emulated_car")


def test_pilot_is_asked_once_a_sample_and_its_control_drives(robot):
    script, diary = Script(lambda tick: FORWARD), Diary()
    with robot.connect(seed=1) as link:
        report = ControlLoop(link, robot.system, listeners=[diary]).run(script, samples=40)
        assert link.pose[0] > 1.0
        assert np.array_equal(link.control, [0.0, 0.0])
    assert report.reason is Reason.SAMPLES
    assert script.ticks == list(range(40))
    assert report.ticks == 40
    assert np.allclose(report.gaps, 0.05)
    assert np.allclose(report.lateness, 0.0, atol=1e-9)
    assert (report.skipped, report.stale, report.drift) == (0, 0, 0.0)
    driven = [command for command in diary.commands if command.control.any()]
    assert [command.tick for command in driven] == list(range(40))
    assert all(command.time == pytest.approx(command.due) for command in driven)
    assert [frame.frame for frame in diary.measurements] == list(range(len(diary.measurements)))


def test_garbage_collection_leaves_out_what_was_there_before_the_run(robot):
    frozen = []
    with robot.connect(seed=1) as link:
        ControlLoop(link, robot.system).run(Script(lambda tick: frozen.append(gc.get_freeze_count())), samples=1)
    assert frozen[0] > 10_000
    assert gc.get_freeze_count() == 0


def test_robot_stands_until_there_is_an_estimate(robot):
    diary = Diary()
    with robot.connect(seed=1) as link:
        ControlLoop(link, robot.system, listeners=[diary]).run(Script(lambda tick: FORWARD), samples=1)
    first = next(command for command in diary.commands if command.control.any())
    assert first.tick == 0
    assert 0.05 < first.time < 0.2
    assert all(not command.control.any() for command in diary.commands if command.time < first.time)


def test_pilot_that_has_enough_leaves_the_connection_open_in_neutral(robot):
    with robot.connect(seed=1) as link:
        loop = ControlLoop(link, robot.system)
        report = loop.run(Script(lambda tick: FORWARD if tick < 5 else None))
        assert report.reason is Reason.PILOT
        assert not report.reason.is_fault
        assert not link.control.any()
        assert loop.run(Script(lambda tick: FORWARD), samples=3).ticks == 3


@pytest.mark.parametrize("control", [np.array([np.nan, 0.0]), np.array([1.0, np.inf])])
def test_control_that_is_not_a_number_ends_in_neutral_before_it_is_sent(robot, control):
    diary = Diary()
    link = FaultyRobot(robot).connect(seed=1)
    report = ControlLoop(link, robot.system, listeners=[diary]).run(
        Script(lambda tick: FORWARD if tick < 3 else control), samples=9
    )
    assert report.reason is Reason.NOT_FINITE
    assert "sample 3" in report.detail
    assert link.closed
    assert np.isfinite([command.control for command in diary.commands]).all()


def test_illegal_control_is_refused_and_the_connection_closed(robot):
    link = FaultyRobot(robot).connect(seed=1)
    with pytest.raises(InvalidArgument, match="drive"):
        ControlLoop(link, robot.system).run(Script(lambda tick: np.array([0.5, 0.0])), samples=3)
    assert link.closed


def test_exception_of_the_pilot_closes_the_connection_first(robot):
    link = FaultyRobot(robot).connect(seed=1)

    def fail(tick):
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        ControlLoop(link, robot.system).run(Script(fail))
    assert link.closed


def test_lost_link_is_a_reason_and_closes_the_connection(robot):
    link = FaultyRobot(robot, broken_at=0.5).connect(seed=1)
    report = ControlLoop(link, robot.system).run(Script(lambda tick: FORWARD), samples=100)
    assert report.reason is Reason.LINK_LOST
    assert "0.25 s" in report.sentence
    assert link.closed


def test_robot_that_tripped_ends_the_run(robot):
    link = FaultyRobot(robot, tripped_at=0.5).connect(seed=1)
    report = ControlLoop(link, robot.system).run(Script(lambda tick: FORWARD), samples=100)
    assert report.reason is Reason.TRIPPED
    assert link.closed


def test_short_dropout_of_the_tracker_does_not_end_the_run(robot):
    diary = Diary()
    link = FaultyRobot(robot, lost=(1.0, 1.09)).connect(seed=1)
    report = ControlLoop(link, robot.system, listeners=[diary]).run(Script(lambda tick: FORWARD), samples=40)
    assert report.reason is Reason.SAMPLES
    assert report.stale == 0
    assert report.rejected == {"not valid": 18}
    assert all(command.control.any() for command in diary.commands if 0.2 < command.time < 2.0)


def test_longer_dropout_means_neutral_after_100_ms_and_the_run_goes_on(robot):
    diary = Diary()
    link = FaultyRobot(robot, lost=(1.02, 1.42)).connect(seed=1)
    script = Script(lambda tick: FORWARD)
    report = ControlLoop(link, robot.system, listeners=[diary]).run(script, samples=40)
    assert report.reason is Reason.SAMPLES
    assert report.stale > 4
    neutral = next(command for command in diary.commands if command.time > 0.5 and not command.control.any())
    assert 1.12 < neutral.time <= 1.13
    driven = [command.time for command in diary.commands if command.control.any() and command.time > neutral.time]
    assert 1.42 < driven[0] < 1.56
    assert max(script.ticks) == 39
    assert len(script.ticks) == 40 - report.stale


def test_tracker_lost_for_half_a_second_ends_the_run(robot):
    link = FaultyRobot(robot, lost=(1.0, 9.0)).connect(seed=1)
    report = ControlLoop(link, robot.system).run(Script(lambda tick: FORWARD), samples=100)
    assert report.reason is Reason.TRACKER_LOST
    assert "not valid" in report.detail
    assert 1.5 < link.time < 1.52
    assert link.closed


def test_run_without_a_first_pose_is_given_up(robot):
    link = FaultyRobot(robot, lost=(-1.0, 9.0)).connect(seed=1)
    script = Script(lambda tick: FORWARD)
    report = ControlLoop(link, robot.system).run(script, samples=100)
    assert report.reason is Reason.TRACKER_LOST
    assert script.ticks == []
    assert link.time < 1.1


def test_missed_ticks_are_skipped_and_counted_and_deadlines_stay(robot):
    link = FaultyRobot(robot, slow={1.0: 26}).connect(seed=1)
    script, diary = Script(lambda tick: FORWARD), Diary()
    report = ControlLoop(link, robot.system, listeners=[diary]).run(script, samples=40)
    assert report.reason is Reason.SAMPLES
    assert report.skipped == 1
    assert len(script.ticks) == 39
    begun = next(i for i, command in enumerate(diary.commands) if command.control.any())
    assert all(command.control.any() for command in diary.commands[begun:-1]), "poses that were waiting are not stale"
    missing = sorted(set(range(40)) - set(script.ticks))
    assert len(missing) == 1
    times = np.array([c.time for c in diary.commands if c.control.any() and c.tick > missing[0]])
    assert times[0] == pytest.approx(1.13)
    assert np.allclose(times[1:] / 0.05, np.round(times[1:] / 0.05))
    assert report.lateness.max() == pytest.approx(0.13)
    assert np.sort(report.lateness)[-2] == pytest.approx(0.03)


def test_jump_within_a_dropout_begins_a_new_track_and_nothing_is_computed_across_it(robot):
    link = FaultyRobot(robot, lost=(1.0, 1.1), moved=(1.05, (0.0, 0.3, 0.0))).connect(seed=1)
    script = Script(lambda tick: FORWARD)
    report = ControlLoop(link, robot.system).run(script, samples=40)
    lateral = np.array([estimate.state[1] for estimate in script.estimates])
    assert report.reason is Reason.SAMPLES
    assert 1 < report.stale < 6
    assert np.abs(lateral).max() < 0.2
    assert script.estimates[-1].pose[1] > 0.2


@pytest.mark.parametrize(("away", "why"), [(0.2, "too fast"), (3.0, "jumped")])
def test_another_place_beyond_reach_ends_the_run(robot, away, why):
    link = FaultyRobot(robot, moved=(1.0, (away, 0.0, 0.0))).connect(seed=1)
    script = Script(lambda tick: FORWARD)
    report = ControlLoop(link, robot.system).run(script, samples=40)
    assert report.reason is Reason.TRACKER_LOST
    assert why in report.detail
    assert max(estimate.state[0] for estimate in script.estimates) < 2.0


def test_frozen_pose_while_driving_means_neutral_and_ends_the_run(robot):
    diary = Diary()
    link = FaultyRobot(robot, frozen_at=1.0).connect(seed=1)
    report = ControlLoop(link, robot.system, listeners=[diary]).run(Script(lambda tick: FORWARD), samples=60)
    assert report.reason is Reason.TRACKER_LOST
    assert "frozen" in report.detail
    neutral = next(command.time for command in diary.commands if command.time > 0.5 and not command.control.any())
    assert neutral < 1.0 + 0.05 + 0.11


def test_every_word_of_the_robot_is_told_once(robot):
    diary = Diary()
    link = FaultyRobot(robot, tripped_at=0.5).connect(seed=1)
    ControlLoop(link, robot.system, listeners=[diary]).run(Script(lambda tick: FORWARD), samples=60)
    assert len(diary.statuses) == 1


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
