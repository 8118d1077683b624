"""Simulated sessions on the host's clock."""

import math
import os
import re
import signal
import threading
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hardware.connection import Connection
from hardware.control_loop import AHEAD, ControlLoop, before_others
from hardware.emulation.simulated_robot import RealTimeRobot, in_real_time
from hardware.emulation.tracked_robots import TRACKER_DELAY
from hardware.run_report import ROBOT, SIGNALS, StopReason, StopRequest
from sysid_evo.cli import console
from sysid_evo.errors import LinkLost
from tests.fixtures.loop import Script

PERIOD = 0.005


def test_frames_come_when_they_are_due_and_keep_their_times(emulated):
    with in_real_time(emulated).connect(seed=1) as connection:
        for _ in range(40):
            frame = connection.measure(1.0)
            assert connection.time >= frame.arrival_time == pytest.approx(frame.source_time + TRACKER_DELAY)
        began = frame.source_time - 39 * PERIOD
        assert connection.time - began >= 39 * PERIOD + TRACKER_DELAY


def test_whoever_calls_late_finds_every_frame_of_the_time_in_between(emulated):
    with in_real_time(emulated).connect(seed=1) as connection:
        time.sleep(0.2)
        deadline = connection.time
        numbers = []
        while (frame := connection.measure(0.0)) is not None and frame.arrival_time <= deadline:
            numbers.append(frame.frame)
        assert numbers == list(range(len(numbers)))
        assert len(numbers) >= 0.19 / PERIOD


def test_a_command_is_in_force_no_longer_than_it_is_valid_however_late_the_next_call(emulated):
    paced, simulated = (robot.connect(seed=3) for robot in (RealTimeRobot(emulated), emulated))
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


def test_nothing_within_the_timeout_is_none_and_a_closed_session_is_lost(emulated):
    connection = in_real_time(emulated).connect(seed=1)
    time.sleep(0.02)
    while connection.measure(0.0) is not None:
        pass
    time.sleep(0.02)
    connection.close()
    with pytest.raises(LinkLost, match="closed"):
        connection.measure(0.0)


def test_a_robot_on_the_hosts_clock_stays_as_it_is(emulated):
    paced = in_real_time(emulated)
    assert in_real_time(paced) is paced
    assert (paced.name, paced.system.dt) == ("emulated_car", 0.05)


FORWARD = np.array([1.0, 0.0])
PROMPT = 0.25  # s; 50 ms, and what else runs on the machine. The run without a stop takes 2 s


class Paced(Connection):
    """Another's connection in simulated time, whose frames come when they are due on the host's clock.

    ``sent`` holds the time and the control of every command, ``closed`` when it was first closed.
    """

    def __init__(self, connection):
        self.connection, self.began = connection, time.monotonic()
        self.sent, self.closed = [], None

    @property
    def time(self):
        return time.monotonic()

    def send(self, control, *, valid_for):
        self.sent.append((time.monotonic(), control))
        self.connection.send(control, valid_for=valid_for)

    def measure(self, timeout):
        due = self.began + self.connection.time + PERIOD
        wait = due - time.monotonic()
        if wait > timeout:
            time.sleep(timeout)
            return None
        time.sleep(max(0.0, wait))
        frame = self.connection.measure(PERIOD)
        return None if frame is None else replace(frame, source_time=due, arrival_time=due)

    def close(self):
        self.closed = self.closed or time.monotonic()
        self.connection.close()


def run_until(emulated, stops, act):
    """Drive in real time, call ``act`` on another thread after 0.4 s; return the report and how long the stop took."""
    acted = []

    def later():
        time.sleep(0.4)
        acted.append(time.monotonic())
        act()

    with Paced(emulated.connect(seed=1)) as link:
        thread = threading.Thread(target=later, name="another")
        thread.start()
        report = ControlLoop(link, emulated.system, stop=stops).run(Script(lambda tick: FORWARD), samples=40)
        thread.join()
        return report, link.closed - acted[0]


@pytest.mark.parametrize("number", list(SIGNALS))
def test_signal_closes_the_connection_at_once_and_is_the_reason(emulated, number):
    before = signal.getsignal(number)
    with StopRequest() as stops:
        report, took = run_until(emulated, stops, lambda: os.kill(os.getpid(), number))
    assert report.reason is SIGNALS[number]
    assert report.reason.exit_code == 128 + number
    assert took < PROMPT
    assert signal.getsignal(number) is before


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_dying_thread_closes_the_connection_and_is_named(emulated):
    told = []
    hook = threading.excepthook
    threading.excepthook = lambda arguments: told.append(arguments.exc_type.__name__)
    try:
        with StopRequest() as stops:

            def die():
                raise ZeroDivisionError("no more")

            report, took = run_until(emulated, stops, die)
        assert report.reason is StopReason.THREAD_DIED
        assert report.sentence == "a thread died: another: ZeroDivisionError: no more"
        assert took < PROMPT
        assert told == ["ZeroDivisionError"], "who looked after dying threads before still does"
    finally:
        threading.excepthook = hook


def test_request_of_another_thread_ends_the_run_and_the_first_one_counts(emulated):
    stops = StopRequest()

    def ask():
        stops.request(StopReason.LINK_LOST, "unplugged")
        stops.request(StopReason.SIGTERM)

    report, took = run_until(emulated, stops, ask)
    assert report.sentence == "the link to the robot or its tracker was lost: unplugged"
    assert took < PROMPT


def test_second_signal_interrupts_whatever_runs():
    with StopRequest() as stops:
        signal.raise_signal(signal.SIGTERM)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
        assert stops.reason is StopReason.SIGTERM


def test_stop_that_came_before_the_run_lets_nothing_drive(emulated):
    stops = StopRequest()
    stops.request(StopReason.SIGINT)
    script = Script(lambda tick: FORWARD)
    report = ControlLoop(emulated.connect(seed=1), emulated.system, stop=stops).run(script, samples=5)
    assert report.reason is StopReason.SIGINT
    assert script.ticks == []


def test_loop_keeps_time_in_real_time(emulated):
    """A busy machine may be late, but the schedule stays: a second of ticks takes a second."""
    with Paced(emulated.connect(seed=1)) as link:
        report = ControlLoop(link, emulated.system).run(Script(lambda tick: FORWARD), samples=20)
        driven = [at for at, control in link.sent if control.any()]
    assert report.reason is StopReason.SAMPLES
    assert (report.ticks + report.skipped, driven[-1] - driven[0]) == (20, pytest.approx(0.95, abs=0.2))
    assert (report.lateness >= 0.0).all()
    assert np.median(report.lateness) < 0.02
    assert report.gaps.sum() == pytest.approx(driven[-1] - driven[0], abs=0.05)


def test_a_loop_in_real_time_runs_before_others_where_that_is_allowed_and_one_in_simulated_time_as_usual(emulated):
    def place():
        return os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK, os.getpriority(os.PRIO_PROCESS, 0)

    def driven(link):
        seen = []
        ControlLoop(link, emulated.system).run(Script(lambda tick: seen.append(place()) or FORWARD), samples=3)
        return set(seen)

    usual = place()
    with before_others():
        best = place()
    assert place() == usual
    with Paced(emulated.connect(seed=1)) as link:
        assert driven(link) == {best}
    assert driven(emulated.connect(seed=1)) == {usual}
    assert place() == usual
    if os.geteuid() == 0:
        assert best[0] == os.SCHED_RR


def test_without_the_right_to_real_time_a_loop_has_a_lower_nice_value_and_without_that_runs_as_usual(monkeypatch):
    schedule, usual = os.sched_setscheduler, os.getpriority(os.PRIO_PROCESS, 0)

    def refuse(thread, policy, parameters):
        if policy & ~os.SCHED_RESET_ON_FORK == os.SCHED_RR:
            raise PermissionError
        schedule(thread, policy, parameters)

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    if os.geteuid() == 0:
        with before_others():
            assert os.getpriority(os.PRIO_PROCESS, 0) == AHEAD < usual
        assert os.getpriority(os.PRIO_PROCESS, 0) == usual
    monkeypatch.setattr(os, "setpriority", lambda *_: refuse(0, os.SCHED_RR, None))
    with before_others():
        assert os.getpriority(os.PRIO_PROCESS, 0) == usual


def test_the_page_on_hardware_lists_the_exit_code_of_every_reason():
    page = (Path(__file__).parents[2] / "docs" / "hardware.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\d+) \| (.+) \|$", page[page.index("| code | reason |") :], re.MULTILINE)
    listed = {reason: [int(code) for code, why in rows if reason.sentence in why] for reason in StopReason}
    assert listed == {reason: [reason.exit_code] for reason in StopReason}
    assert {int(code) for code, _ in rows} == {reason.exit_code for reason in StopReason} | {console.WRONG_INPUT}
    assert StopReason.LINK_LOST.exit_code == ROBOT == console.ROBOT
    assert all(f"{code} " in console.EXIT_CODES for code in {int(code) for code, _ in rows} - {129, 143})
    assert {reason for reason in StopReason if not reason.is_fault} == {StopReason.SAMPLES, StopReason.PILOT}


@pytest.mark.parametrize("catches", [0, 1])
def test_a_call_that_does_not_come_back_ends_after_its_patience(catches):
    with StopRequest(patience=0.2) as stops:

        def call():
            for _ in range(catches):  # a robot's own loop may catch it, and go on
                with suppress(LinkLost):
                    time.sleep(30.0)
            time.sleep(30.0)

        with pytest.raises(LinkLost, match=r"the arm: no answer for 0\.2 s"), stops.answer("the arm"):
            call()
        with stops.answer("the arm"):
            pass
        time.sleep(0.4)  # one that has answered is not waited for any more
    assert stops.reason is None
    assert signal.getsignal(signal.SIGALRM) is signal.SIG_DFL
    with StopRequest().answer("the arm"):  # where nobody looks after signals nothing is raised
        assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


def test_a_signal_ends_a_call_that_may_wait_for_ever():
    with StopRequest() as stops:
        threading.Timer(0.2, lambda: os.kill(os.getpid(), signal.SIGTERM)).start()
        with pytest.raises(LinkLost, match="no answer within 1 s of the signal"), stops.answer("the arm", math.inf):
            time.sleep(30.0)
    assert stops.reason is StopReason.SIGTERM
