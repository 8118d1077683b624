"""The emulated car's process: it answers, drives, sees, breaks as told, and ends with its host."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from hardware.link.messages import Buttons, State
from hardware.trackers.udp import UdpTracker
from sysid_evo.errors import LinkLost
from tests.system.rig.bare_host import PATIENCE, BareHost
from tests.system.rig.faults import Fault
from tests.system.rig.journal import opened_after, read_journal
from tests.system.rig.terminal_process import TerminalProcess

MARGIN = 0.1  # s for a loaded machine, on top of what the firmware guarantees
TRACKER = UdpTracker("car", 0, clock="host")


def wait_until(condition):
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.01)


def is_running(pid):
    """Whether the process exists and is no zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_commands_move_the_car_and_silence_stops_it(tmp_path):
    journal = tmp_path / "journal"
    with TRACKER.open() as stream, TerminalProcess(tracker=stream.address, seed=1, journal=journal) as process:
        with BareHost(process.port) as host:
            host.hello()
            host.command(Buttons.NONE)
            for _ in range(12):
                host.command(Buttons.FORWARD)
                time.sleep(0.05)
            last = time.monotonic()
            wait_until(lambda: opened_after(read_journal(journal), last) is not None)
            host.status(Buttons.NONE, State.TRIPPED)
        frames = []
        while (frame := stream.read(0.1)) is not None and len(frames) < 400:
            frames.append(frame)
    opened = opened_after(read_journal(journal), last)
    assert opened is not None
    assert opened - last < 0.15 + MARGIN
    poses = np.array([frame.pose for frame in frames])
    assert poses[-1, 0] > 0.2
    assert all(frame.valid for frame in frames)


def test_frames_carry_consecutive_numbers_and_times_on_the_host_s_clock():
    with TRACKER.open() as stream, TerminalProcess(tracker=stream.address, seed=1):
        before = time.monotonic()
        frames = [stream.read(PATIENCE) for _ in range(100)]
    seen = [frame for frame in frames if frame is not None]
    assert [frame.frame for frame in seen] == list(range(seen[0].frame, seen[0].frame + 100))
    np.testing.assert_allclose(np.diff([frame.source_time for frame in seen]), 0.005, atol=1e-9)
    assert before - PATIENCE < seen[0].source_time < seen[-1].source_time < time.monotonic()


def test_the_same_seed_sees_the_same_noise():
    def first_poses(seed):
        with TRACKER.open() as stream, TerminalProcess(tracker=stream.address, seed=seed):
            frames = [stream.read(PATIENCE) for _ in range(5)]
        return [frame.pose.tolist() for frame in frames if frame is not None]

    assert first_poses(3) == first_poses(3)


def test_a_stop_opens_the_buttons_at_once():
    with TerminalProcess(seed=1) as process, BareHost(process.port) as host:
        host.hello()
        host.drive(Buttons.FORWARD | Buttons.LEFT)
        host.stop()
        host.status(Buttons.NONE)
        assert all(message.trips == 0 for message in host.heard if hasattr(message, "trips"))


def test_a_reset_makes_a_new_boot_and_the_old_session_is_worth_nothing():
    with TerminalProcess(seed=1) as process, BareHost(process.port) as host:
        first = host.hello()
        host.drive(Buttons.FORWARD)
        process.inject(Fault(kind="reset"))
        assert host.status(Buttons.NONE).state is State.WAITING
        host.command(Buttons.FORWARD)
        for _ in range(2):
            assert host.status(Buttons.NONE).state is State.WAITING
        again = host.hello(nonce=2)
        assert again.boot_count == first.boot_count + 1
        assert again.reset_cause != first.reset_cause


def test_a_pulled_plug_opens_the_buttons_and_comes_back_under_the_same_name(tmp_path):
    journal = tmp_path / "journal"
    with TerminalProcess(seed=1, journal=journal) as process:
        with BareHost(process.port) as host:
            host.hello()
            host.drive(Buttons.FORWARD)
            process.inject(Fault(kind="unplug", duration=0.4))
            with pytest.raises(EOFError):
                host.status(Buttons.BACKWARD)
        wait_until(lambda: Path(process.port).exists())
        with BareHost(process.port) as host:
            assert host.status(Buttons.NONE).state is State.TRIPPED
            host.hello(nonce=2)
            host.drive(Buttons.BACKWARD)
    entries = read_journal(journal)
    pulled = next(entry.time for entry in entries if entry.event == "unplug")
    opened = next(entry.time for entry in entries if entry.event == "buttons" and entry.value == 0)
    assert opened - pulled < 0.15 + MARGIN


def test_damaged_commands_close_nothing():
    with TerminalProcess(seed=1) as process, BareHost(process.port) as host:
        host.hello()
        host.drive(Buttons.LEFT)
        process.inject(Fault(kind="flip", duration=0.4))
        time.sleep(0.1)
        host.command(Buttons.FORWARD)
        status = host.status(Buttons.NONE, State.TRIPPED)
        assert status.crc + status.length > 0
        assert status.last_sequence == 2


def test_firmware_of_another_major_version_says_so():
    with TerminalProcess(seed=1, faults=[Fault(kind="version")]) as process, BareHost(process.port) as host:
        assert host.hello().major == 2


def test_it_ends_when_its_host_closes_it_and_leaves_nothing_behind():
    process = TerminalProcess(seed=1)
    folder = Path(process.port).parent
    process.close()
    process.close()
    assert not is_running(process.pid)
    assert not folder.exists()
    with pytest.raises(LinkLost, match="has ended"):
        process.inject(Fault(kind="reset"))


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_it_cleans_up_when_it_is_told_to_go(number):
    with TerminalProcess(seed=1) as process:
        os.kill(process.pid, number)
        wait_until(lambda: not is_running(process.pid))
        assert not Path(process.port).parent.exists()


def test_it_ends_when_its_host_is_killed():
    program = (
        "from tests.system.rig.terminal_process import TerminalProcess\n"
        "import json, time\n"
        "process = TerminalProcess(seed=1)\n"
        "print(json.dumps([process.pid, process.port]), flush=True)\n"
        "time.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE) as host:
        assert host.stdout is not None
        pid, port = json.loads(host.stdout.readline())
        assert is_running(pid)
        host.kill()
        wait_until(lambda: not is_running(pid))
        assert not Path(port).parent.exists()


def test_a_process_that_cannot_start_is_an_error(capfd):
    with pytest.raises(LinkLost, match="ended before it was ready"):
        TerminalProcess(tracker=("127.0.0.1", -1), seed=-1)
    assert "seed" in capfd.readouterr().err
