"""The control loop in simulated time, on the emulated car."""

import gc
import re

import numpy as np
import pytest

from hardware.connection import GateLimits
from hardware.control_loop import ControlLoop
from hardware.emulation.tracked_robots import TrackedRobot
from hardware.recording.journal import read_journal
from hardware.recording.manoeuvres import Manoeuvre
from hardware.recording.record import RecordingJob, record_journals
from hardware.run_report import StopReason
from sysid_evo.errors import InvalidArgument
from sysid_evo.models import Dynamics
from sysid_evo.motion import PlanarBody
from sysid_evo.system import Channel, System
from tests.fixtures.loop import Diary, FaultyRobot, Script

FORWARD = np.array([1.0, 0.0])


@pytest.fixture
def drive(emulated):
    """Drives the car with faults; leaves the connection, the script and the diary of the run beside it."""

    def run(samples, control=lambda tick: FORWARD, **faults):
        run.script, run.diary, run.link = Script(control), Diary(), FaultyRobot(emulated, **faults).connect(seed=1)
        return ControlLoop(run.link, emulated.system, listeners=[run.diary]).run(run.script, samples=samples)

    return run


def moving(diary):
    return [command for command in diary.commands if command.control.any()]


def first_neutral(diary):
    return next(command.time for command in diary.commands if command.time > 0.5 and not command.control.any())


def test_pilot_is_asked_once_a_sample_and_its_control_drives(drive):
    report = drive(40)
    with drive.link.connection as link:
        assert link.pose[0] > 1.0
        assert np.array_equal(link.control, [0.0, 0.0])
    assert report.reason is StopReason.SAMPLES
    assert (drive.script.ticks, report.ticks) == (list(range(40)), 40)
    assert np.allclose(report.gaps, 0.05)
    assert np.allclose(report.lateness, 0.0, atol=1e-9)
    assert (report.skipped, report.stale) == (0, 0)
    driven = moving(drive.diary)
    assert [command.tick for command in driven] == list(range(40))
    assert all(command.time == pytest.approx(command.due) for command in driven)
    frames = [frame.frame for frame in drive.diary.measurements]
    assert frames == list(range(len(frames)))


def test_garbage_collection_leaves_out_what_was_there_before_the_run(drive):
    frozen = []
    drive(1, lambda tick: frozen.append(gc.get_freeze_count()))
    assert frozen[0] > 10_000
    assert gc.get_freeze_count() == 0


def test_the_robot_is_neutral_until_there_is_an_estimate(drive):
    drive(1)
    first = moving(drive.diary)[0]
    assert first.tick == 0
    assert 0.05 < first.time < 0.2
    assert all(not command.control.any() for command in drive.diary.commands if command.time < first.time)


def test_pilot_that_has_enough_leaves_the_connection_open_in_neutral(emulated):
    with emulated.connect(seed=1) as link:
        loop = ControlLoop(link, emulated.system)
        report = loop.run(Script(lambda tick: FORWARD if tick < 5 else None))
        assert report.reason is StopReason.PILOT
        assert not report.reason.is_fault
        assert not link.control.any()
        assert loop.run(Script(lambda tick: FORWARD), samples=3).ticks == 3


@pytest.mark.parametrize("control", [np.array([np.nan, 0.0]), np.array([1.0, np.inf])])
def test_control_that_is_not_a_number_ends_in_neutral_before_it_is_sent(drive, control):
    report = drive(9, lambda tick: FORWARD if tick < 3 else control)
    assert report.reason is StopReason.NOT_FINITE
    assert "sample 3" in report.detail
    assert drive.link.closed
    assert np.isfinite([command.control for command in drive.diary.commands]).all()


@pytest.mark.parametrize(
    ("control", "error", "match"),
    [
        (lambda tick: np.array([0.5, 0.0]), InvalidArgument, "drive"),
        (lambda tick: 1 / 0, ZeroDivisionError, "division"),
    ],
    ids=["an illegal control", "an exception of the pilot"],
)
def test_what_the_pilot_may_not_do_closes_the_connection_first(drive, control, error, match):
    with pytest.raises(error, match=match):
        drive(3, control)
    assert drive.link.closed


@pytest.mark.parametrize(
    ("faults", "reason", "why"),
    [
        ({"broken_at": 0.5}, StopReason.LINK_LOST, "0.25 s"),
        ({"tripped_at": 0.5}, StopReason.TRIPPED, ""),
        ({"lost": (1.0, 9.0)}, StopReason.TRACKER_LOST, "not valid"),
        ({"lost": (-1.0, 9.0)}, StopReason.TRACKER_LOST, ""),
        ({"moved": (1.0, (0.2, 0.0, 0.0))}, StopReason.TRACKER_LOST, "too fast"),
        ({"moved": (1.0, (3.0, 0.0, 0.0))}, StopReason.TRACKER_LOST, "jumped"),
        ({"frozen_at": 1.0}, StopReason.TRACKER_LOST, "frozen"),
    ],
)
def test_a_fault_ends_the_run_with_its_reason_and_closes_the_connection(drive, faults, reason, why):
    report = drive(60, **faults)
    assert report.reason is reason
    assert why in report.sentence
    assert drive.link.closed
    estimates = drive.script.estimates
    if "moved" in faults:
        assert max(estimate.state[0] for estimate in estimates) < 2.0
    elif "frozen_at" in faults:
        assert first_neutral(drive.diary) < 1.0 + 0.05 + 0.11
    elif "lost" in faults:  # given up half a second after the last pose, or after a second without a first one
        earliest, latest = (1.5, 1.52) if estimates else (0.0, 1.1)
        assert earliest < drive.link.time < latest
        assert bool(drive.script.ticks) == (faults["lost"][0] > 0.0)
    elif "tripped_at" in faults:
        assert len(drive.diary.statuses) == 1, "every word of the robot is told once"


def test_short_dropout_of_the_tracker_does_not_end_the_run(drive):
    report = drive(40, lost=(1.0, 1.09))
    assert report.reason is StopReason.SAMPLES
    assert report.stale == 0
    assert report.rejected == {"not valid": 18}
    assert all(command.control.any() for command in drive.diary.commands if 0.2 < command.time < 2.0)


def test_longer_dropout_means_neutral_after_100_ms_and_the_run_goes_on(drive):
    report = drive(40, lost=(1.02, 1.42))
    assert report.reason is StopReason.SAMPLES
    assert report.stale > 4
    neutral = first_neutral(drive.diary)
    assert 1.12 < neutral <= 1.13
    assert 1.42 < next(command.time for command in moving(drive.diary) if command.time > neutral) < 1.56
    assert max(drive.script.ticks) == 39
    assert len(drive.script.ticks) == 40 - report.stale


def test_missed_ticks_are_skipped_and_counted_and_deadlines_stay(drive):
    report = drive(40, slow={1.0: 26})
    assert report.reason is StopReason.SAMPLES
    assert report.skipped == 1
    commands = drive.diary.commands
    begun = next(i for i, command in enumerate(commands) if command.control.any())
    assert all(command.control.any() for command in commands[begun:-1]), "poses that were waiting are not stale"
    (missing,) = set(range(40)) - set(drive.script.ticks)
    assert len(drive.script.ticks) == 39
    times = np.array([command.time for command in moving(drive.diary) if command.tick > missing])
    assert times[0] == pytest.approx(1.13)
    assert np.allclose(times[1:] / 0.05, np.round(times[1:] / 0.05))
    assert report.lateness.max() == pytest.approx(0.13)
    assert np.sort(report.lateness)[-2] == pytest.approx(0.03)


def test_jump_within_a_dropout_begins_a_new_track_and_nothing_is_computed_across_it(drive):
    report = drive(40, lost=(1.0, 1.1), moved=(1.05, (0.0, 0.3, 0.0)))
    assert report.reason is StopReason.SAMPLES
    assert 1 < report.stale < 6
    assert np.abs([estimate.state[1] for estimate in drive.script.estimates]).max() < 0.2
    assert drive.script.estimates[-1].pose[1] > 0.2


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


def sledged(folder, gate):
    robot = TrackedRobot("sled", Sled(), repeats=10, gate=gate)
    return record_journals(robot, [Manoeuvre("away", np.ones((40, 1)))], folder, RecordingJob(1))


def test_a_robot_that_is_too_fast_for_the_gate_is_lost_with_its_speed_the_limit_and_the_key(tmp_path):
    report = sledged(tmp_path, None)
    assert report.reason is StopReason.TRACKER_LOST
    assert "the newest pose is 0.5" in report.detail
    seen = re.search(r"it moves at ([\d.]+) m/s, frames above speed = 5 m/s are rejected; .* \[gate\]", report.detail)
    assert seen is not None
    assert 7.0 < float(seen[1]) < 12.0


def test_the_same_robot_is_accepted_with_its_own_limits_and_the_journal_stores_them(tmp_path):
    report = sledged(tmp_path, GateLimits(speed=15.0))
    assert (report.reason, report.rejected) == (StopReason.PILOT, {})
    assert read_journal(tmp_path / "away.rcj").limits.speed == 15.0
