"""Trackers in a process of their own: what comes through, and how either side learns of the other's end."""

import os
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from hardware.connection import Measurement
from hardware.trackers.process import RECORD, record_of
from sysid_evo.errors import InvalidArgument, LinkLost, MissingExtra
from sysid_evo.registry import trackers
from tests.fixtures.trackers import MissingTracker, MockTracker, PolledMockTracker, ScriptedTracker, read_all

SOURCE = "from tests.fixtures.trackers import ScriptedTracker"


def alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


def ends(pid, within=2.0):
    deadline = time.monotonic() + within
    while alive(pid) and time.monotonic() < deadline:
        time.sleep(0.005)
    return not alive(pid)


def test_frames_come_through_as_they_were_made():
    with ScriptedTracker(script="end").open() as stream:
        frames, last = read_all(stream)
    assert [frame.frame for frame in frames] == [0, 1, 2, 3, 4]
    assert [frame.valid for frame in frames] == [True, False, True, True, False]
    assert np.array_equal(frames[3].pose, [0.1 * 3, 1.0, -0.5])
    assert np.isnan(frames[1].pose).all()
    assert all(frame.arrival_time - frame.source_time == pytest.approx(0.004) for frame in frames)
    assert all(0.0 <= time.monotonic() - frame.arrival_time < 10.0 for frame in frames)
    assert "source has ended" in last


def test_descriptor_is_readable_exactly_while_a_frame_waits():
    with ScriptedTracker(script="hang", count=3).open() as stream:
        for _ in range(3):
            assert select.select([stream], [], [], 5.0)[0] == [stream]
            assert stream.read(0.0) is not None
        assert select.select([stream], [], [], 0.1)[0] == []
        assert stream.read(0.0) is None


@pytest.mark.parametrize(
    "script, said", [("break", "ZeroDivisionError: in the driver"), ("crash", "its process ended (exit code -6)")]
)
def test_end_of_the_process_is_a_lost_link(script, said):
    with ScriptedTracker(script=script).open() as stream:
        frames, last = read_all(stream)
        with pytest.raises(LinkLost, match="its process ended"):
            stream.read(1.0)
    assert len(frames) == 5
    assert said in last


def test_source_that_refuses_or_says_nothing_is_a_lost_link(monkeypatch):
    with pytest.raises(LinkLost, match="the source refuses"):
        ScriptedTracker(script="refuse").open()
    monkeypatch.setattr("hardware.trackers.process.PATIENCE", 0.5)
    with pytest.raises(LinkLost, match="nothing answered"):
        ScriptedTracker(script="mute").open()


@pytest.mark.parametrize("script", ["end", "hang"])
def test_killed_process_is_a_lost_link_and_closing_ends_it(script):
    with ScriptedTracker(script=script, count=9999).open() as stream:
        os.kill(stream.pid, signal.SIGKILL)
        assert "exit code -9" in read_all(stream)[1]
    stream = ScriptedTracker(script=script, count=3).open()
    stream.close()
    stream.close()
    assert ends(stream.pid)
    with pytest.raises(LinkLost, match="closed"):
        stream.read(0.0)


@pytest.mark.parametrize("count, period", [(3, 0.001), (99_999, 0.005)])
def test_process_ends_with_the_one_that_opened_it_even_while_it_hangs_inside_a_library(count, period):
    code = (
        f"{SOURCE}\nimport time\nstream = ScriptedTracker(script='hang', count={count}, period={period}).open()\n"
        "print(stream.pid, flush=True)\ntime.sleep(60)"
    )
    opener = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    pid = int(opener.stdout.readline())
    time.sleep(0.3)
    assert alive(pid)
    opener.kill()
    opener.communicate()
    assert ends(pid)


def test_reader_that_stalls_gets_whole_frames_and_no_more_than_the_pipe_holds():
    with ScriptedTracker(script="hang", count=400, period=0.0).open() as stream:
        time.sleep(1.0)
        frames = []
        while (frame := stream.read(0.0)) is not None:
            frames.append(frame.frame)
    assert frames == list(range(len(frames)))
    assert 100 < len(frames) < 400


def test_missing_package_is_named_with_its_installation_before_a_process_starts():
    for attempt in (MissingTracker().check, MissingTracker().open):
        with pytest.raises(MissingExtra, match=r"needs the package 'no_such_package'.*pip install"):
            attempt()


def test_every_record_has_one_length():
    longest = Measurement(-1.2345678901234567e-300, 1.0, 2**63, "ü" * 500, True, np.full(3, -1.2345678901234567e-300))
    assert {len(record_of(item)) for item in (longest, True, "ü" * 999, '"' * 999)} == {RECORD}


def test_motion_capture_system_is_read_through_its_package():
    pytest.importorskip("motioncapture")
    with MockTracker("car", scale=0.001).open() as stream:
        frames = [stream.read(5.0) for _ in range(4)]
    assert [frame.frame for frame in frames] == [1, 2, 3, 4]
    assert frames[0].pose == pytest.approx([1.0, 2.0, np.pi / 2])
    assert all(frame.valid and frame.source_time == frame.arrival_time for frame in frames)
    with MockTracker("truck").open() as stream:
        lost = stream.read(5.0)
    assert not lost.valid
    with PolledMockTracker("car").open() as stream:
        assert stream.read(5.0).frame == 1
        assert stream.read(0.1) is None


def test_vrpn_server_that_is_not_there_gives_no_frames():
    pytest.importorskip("motioncapture")
    with trackers.make("vrpn", body="car", host="localhost:39998").open() as stream:
        assert stream.read(0.1) is None


def test_wrong_arguments_are_refused():
    with pytest.raises(InvalidArgument, match="up"):
        trackers.make("vicon", body="car", up="x")
    with pytest.raises(InvalidArgument, match="scale"):
        trackers.make("natnet", body="car", scale=0.0)
