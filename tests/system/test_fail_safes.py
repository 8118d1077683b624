"""The fail-safes of the whole chain, few times each; ``python -m tests.benchmarks.robot`` does it many times.

Bounds in time are those of the firmware, which opens the buttons when a command outlives its 150 ms,
plus what a loaded machine may take from the processes that watch it.
"""

import itertools
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from hardware.connection import GateLimits
from hardware.link.messages import Buttons, State
from hardware.trackers.udp import UdpTracker
from sysid_evo.errors import LinkLost
from tests.benchmarks.robot.blinding import BOUND, blind
from tests.benchmarks.robot.cutting import cut
from tests.benchmarks.robot.killing import kill
from tests.benchmarks.robot.stopping import stop
from tests.benchmarks.robot.suspending import suspend
from tests.fixtures.waiting import is_running, wait_until
from tests.system.rig.bare_host import PATIENCE, BareHost
from tests.system.rig.board import EXTERNAL
from tests.system.rig.faults import Fault
from tests.system.rig.journal import opened_after, read_journal
from tests.system.rig.killed_recorder import kill_once
from tests.system.rig.terminal_car import TerminalCar
from tests.system.rig.terminal_process import TerminalProcess

LOAD = 0.2  # s
SEED = 5
MARGIN = 0.1  # s for a loaded machine, on top of what the firmware guarantees
FORWARD = np.array([1.0, 0.0])
TRACKER = UdpTracker("car", 0, clock="host")


def check(rows):
    for row in rows:
        assert row.holds, f"{row.case}: {row.demand}: {row.passed} of {row.count}, {row.figures}"


@pytest.mark.parametrize("repeats", [2, pytest.param(20, marks=pytest.mark.nightly)])
def test_buttons_open_when_the_host_is_killed(tmp_path, repeats):
    check(kill(tmp_path, repeats=repeats, seed=SEED, margin=LOAD))


def test_a_terminated_host_stops_the_car_and_says_that_it_failed(tmp_path):
    check(stop(tmp_path, repeats=1, seed=SEED, bound=0.05 + LOAD, cases=(signal.SIGTERM,)))


def test_a_host_that_was_stopped_for_a_second_does_not_drive_on(tmp_path):
    check(suspend(tmp_path, repeats=1, seed=SEED, durations=(1.0,)))


def test_a_cut_line_stops_the_car_and_another_version_is_refused(tmp_path):
    check(cut(tmp_path, repeats=1, seed=SEED, margin=LOAD, kinds=("unplug",)))


def test_a_blind_tracker_stops_the_car_and_no_speed_comes_out_of_a_jump(tmp_path):
    check(blind(tmp_path, repeats=1, seed=SEED, bound=BOUND + LOAD, faults=(("dropout", 0.3), ("identity_swap", 0.3))))


@pytest.mark.nightly
@pytest.mark.parametrize(
    "attack",
    [
        lambda folder: stop(folder, repeats=2, seed=SEED, bound=0.05 + LOAD),
        lambda folder: cut(folder, repeats=3, seed=SEED, margin=LOAD),
        lambda folder: blind(folder, repeats=3, seed=SEED, bound=BOUND + LOAD),
        lambda folder: suspend(folder, repeats=3, seed=SEED),
    ],
    ids=[
        "a host that ends in any way",
        "a clogged line and a reset",
        "all faults of the tracker",
        "stops of any length",
    ],
)
def test_the_car_stops_in_every_case_of_the_benchmarks(tmp_path, attack):
    check(attack(tmp_path))


def test_recorder_that_is_killed_loses_at_most_one_record(tmp_path):
    for number in range(3):
        trial = kill_once(tmp_path / f"{number}.rcj", delay=0.02 + 0.013 * number)
        assert 0 <= trial.lost <= 1
        assert trial.stored > 10


def forward_for_a_second(journals):
    """Return connection, poses and journal; begin anew where the machine pauses longer than a command lives."""
    for attempt in range(5):
        journal, poses = journals / f"journal{attempt}", []
        connection = TerminalCar(journal=journal, gate=GateLimits(speed=8.0)).connect(seed=1)
        try:
            for _ in range(20):
                connection.send(FORWARD, valid_for=0.15)
                due = connection.time + 0.05
                while (left := due - connection.time) > 0.0:
                    if (frame := connection.measure(left)) is not None:
                        poses.append(frame.pose)
        except LinkLost as lost:
            connection.close()
            if "longest pause" not in str(lost):
                raise
        else:
            return connection, poses, journal
    raise AssertionError("this machine pauses too often")


def test_a_physical_connection_drives_the_car_and_closing_ends_its_process_once(tmp_path):
    connection, poses, journal = forward_for_a_second(tmp_path)
    assert connection.gate_limits == GateLimits(speed=8.0)
    assert connection.status.state == "driving"
    np.testing.assert_array_equal(connection.status.control, FORWARD)
    connection.close()
    connection.close()
    assert poses[-1][0] > 0.3
    entries = read_journal(journal)
    assert entries[-1].event == "end"
    assert [entry.value for entry in entries if entry.event == "buttons"] == [1, 0]
    assert not Path(f"/proc/{entries[0].value}").exists()
    with pytest.raises(LinkLost, match="closed"):
        connection.measure(0.0)


def test_a_pulled_plug_is_a_lost_link():
    with TerminalCar(faults=[Fault(kind="unplug", at=0.5)]).connect(seed=1) as connection:
        with pytest.raises(LinkLost, match="gone"):
            [connection.measure(0.05) for _ in range(2000)]  # ten seconds of frames
        with pytest.raises(LinkLost, match="gone"):
            connection.send(FORWARD, valid_for=0.15)


NONCES = itertools.count(1)


@pytest.fixture(scope="module")
def process(tmp_path_factory):
    """The car's process, which every test leaves unhurt; its journal and what its tracker sees stand beside it."""
    journal = tmp_path_factory.mktemp("rig") / "journal"
    with TRACKER.open() as stream, TerminalProcess(tracker=stream.address, seed=1, journal=journal) as process:
        process.journal, process.stream = journal, stream
        yield process


@pytest.fixture
def host(process):
    """A host in a session of its own; what the tracker saw before has been read."""
    while process.stream.read(0.0) is not None:
        pass
    with BareHost(process.port) as host:
        host.answer = host.hello(next(NONCES))
        yield host


def test_commands_move_the_car_and_silence_stops_it(process, host):
    for _ in range(5):  # a machine that pauses for longer than a command lives stops the car before its time
        host.command(Buttons.NONE)
        for _ in range(12):
            host.command(Buttons.FORWARD)
            time.sleep(0.05)
        last = time.monotonic()
        wait_until(lambda since=last: opened_after(read_journal(process.journal), since) is not None)
        host.status(Buttons.NONE, State.TRIPPED)
        frames = []
        while (frame := process.stream.read(0.1)) is not None and frame.source_time < last:
            frames.append(frame)
        if np.hypot(*(frames[-1].pose - frames[0].pose)[:2]) > 0.2:
            break
        host.answer = host.hello(next(NONCES))
    assert opened_after(read_journal(process.journal), last) - last < 0.15 + MARGIN
    assert np.hypot(*(frames[-1].pose - frames[0].pose)[:2]) > 0.2
    assert all(frame.valid for frame in frames)


def test_frames_carry_consecutive_numbers_and_times_on_the_host_s_clock(process, host):
    before = time.monotonic()
    frames = [process.stream.read(PATIENCE) for _ in range(100)]
    assert [frame.frame for frame in frames] == list(range(frames[0].frame, frames[0].frame + 100))
    np.testing.assert_allclose(np.diff([frame.source_time for frame in frames]), 0.005, atol=1e-9)
    assert before - PATIENCE < frames[0].source_time < frames[-1].source_time < time.monotonic()


def test_a_stop_opens_the_buttons_at_once(host):
    host.drive(Buttons.FORWARD | Buttons.LEFT)
    trips = host.heard[-1].trips
    host.stop()
    assert host.status(Buttons.NONE).trips == trips


def test_a_reset_makes_a_new_boot_and_the_old_session_is_worth_nothing(process, host):
    host.drive(Buttons.FORWARD)
    process.inject(Fault(kind="reset"))
    assert host.status(Buttons.NONE).state is State.WAITING
    host.command(Buttons.FORWARD)
    for _ in range(2):
        assert host.status(Buttons.NONE).state is State.WAITING
    again = host.hello(next(NONCES))
    assert again.boot_count == host.answer.boot_count + 1
    assert again.reset_cause == EXTERNAL


def test_a_pulled_plug_opens_the_buttons_and_comes_back_under_the_same_name(process, host):
    host.drive(Buttons.FORWARD)
    since = time.monotonic()
    process.inject(Fault(kind="unplug", duration=0.4))
    with pytest.raises(EOFError):
        host.status(Buttons.BACKWARD)
    wait_until(lambda: Path(process.port).exists())
    with BareHost(process.port) as again:
        assert again.status(Buttons.NONE).state is State.TRIPPED
        again.hello(next(NONCES))
        again.drive(Buttons.BACKWARD)
    entries = [entry for entry in read_journal(process.journal) if entry.time > since]
    pulled = next(entry.time for entry in entries if entry.event == "unplug")
    opened = next(entry.time for entry in entries if entry.event == "buttons" and entry.value == 0)
    assert opened - pulled < 0.15 + MARGIN


def test_damaged_commands_close_nothing(process, host):
    host.drive(Buttons.LEFT)
    before = host.heard[-1]
    process.inject(Fault(kind="flip", duration=0.4))
    time.sleep(0.1)
    host.command(Buttons.FORWARD)
    host.status(Buttons.NONE, State.TRIPPED)
    host.command(Buttons.FORWARD)  # the line is sound again: its delimiter ends what was damaged
    status = [host.status(Buttons.NONE, State.TRIPPED) for _ in range(4)][-1]
    assert status.crc + status.length > before.crc + before.length
    assert status.last_sequence == 2


def test_the_same_seed_sees_the_same_noise_and_nothing_is_left_behind_however_it_ends():
    seen = []
    for end in (None, signal.SIGTERM, signal.SIGHUP):
        faults = [Fault(kind="version")] if end is None else []
        with TRACKER.open() as stream, TerminalProcess(tracker=stream.address, seed=3, faults=faults) as process:
            seen.append([stream.read(PATIENCE).pose.tolist() for _ in range(5)])
            if end is None:
                with BareHost(process.port) as host:
                    assert host.hello().major == 2, "firmware of another major version says so"
                process.close()
                process.close()
                with pytest.raises(LinkLost, match="has ended"):
                    process.inject(Fault(kind="reset"))
            else:
                os.kill(process.pid, end)
            wait_until(lambda pid=process.pid: not is_running(pid))
            assert not Path(process.port).parent.exists()
    assert seen[0] == seen[1] == seen[2]


def test_it_ends_when_its_host_is_killed():
    program = (
        "from tests.system.rig.terminal_process import TerminalProcess\n"
        "import json, time\n"
        "process = TerminalProcess(seed=1)\n"
        "print(json.dumps([process.pid, process.port]), flush=True)\n"
        "time.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE) as host:
        pid, port = json.loads(host.stdout.readline())
        assert is_running(pid)
        host.kill()
        wait_until(lambda: not is_running(pid))
        assert not Path(port).parent.exists()


def test_a_process_that_cannot_start_is_an_error(capfd):
    with pytest.raises(LinkLost, match="ended before it was ready"):
        TerminalProcess(tracker=("127.0.0.1", -1), seed=-1)
    assert "seed" in capfd.readouterr().err
