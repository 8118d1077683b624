"""Trackers in a process of their own: what comes through, and how either side learns of the other's end."""

import itertools
import math
import os
import select
import signal
import socket
import struct
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from hardware.connection import Measurement
from hardware.trackers.process import RECORD, record_of
from hardware.trackers.tracker import Axes
from sysid_evo.errors import LinkLost, MissingExtra
from sysid_evo.registry import trackers
from tests.fixtures.trackers import MissingTracker, MockTracker, PolledMockTracker, ScriptedTracker, read_all
from tests.fixtures.waiting import is_running, wait_until


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


def test_killed_process_is_a_lost_link_and_closing_ends_one_that_hangs():
    with ScriptedTracker(count=9999).open() as stream:
        os.kill(stream._process.pid, signal.SIGKILL)
        assert "exit code -9" in read_all(stream)[1]
    stream = ScriptedTracker(script="hang", count=3).open()
    stream.close()
    stream.close()
    wait_until(lambda: not is_running(stream._process.pid), 2.0)
    with pytest.raises(LinkLost, match="closed"):
        stream.read(0.0)


def test_process_ends_with_the_one_that_opened_it_even_while_it_hangs_inside_a_library():
    code = (
        "import time\nfrom tests.fixtures.trackers import ScriptedTracker\n"
        "ways = {'count': 3, 'period': 0.001}, {'count': 99_999}\n"
        "streams = [ScriptedTracker(script='hang', **way).open() for way in ways]\n"
        "print(*(stream._process.pid for stream in streams), flush=True)\ntime.sleep(60)"
    )
    opener = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    pids = [int(pid) for pid in opener.stdout.readline().split()]
    time.sleep(0.3)
    assert list(map(is_running, pids)) == [True, True]
    opener.kill()
    opener.communicate()
    wait_until(lambda: not any(map(is_running, pids)), 2.0)


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


def test_vrpn_server_that_is_not_there_gives_no_frames_and_a_silent_natnet_server_is_a_lost_link():
    pytest.importorskip("motioncapture")
    with trackers.make("vrpn", body="car", host="localhost:39998").open() as stream:
        assert stream.read(0.1) is None
    pytest.importorskip("natnet")
    with pytest.raises(LinkLost, match="no NatNet server answers"):
        trackers.make("natnet", body="car", command_port=1).open()


pytest.importorskip("natnet")

PERIOD = 0.005  # s
BODIES = {"truck": 7, "car": 12}


def about(axis, angle):
    """Return the quaternion (x, y, z, w) of a turn about one axis."""
    vector = [0.0, 0.0, 0.0]
    vector[axis] = math.sin(angle / 2)
    return (*vector, math.cos(angle / 2))


class MotiveServer:
    """Answers on a UDP port as Motive does in unicast: server info, list of rigid bodies, frames at 200 Hz."""

    def __init__(self, version):
        self.version = version
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(PERIOD)
        self.port = self.socket.getsockname()[1]
        self.client = None
        self.number = 0
        self.garbage, self.lost = [], range(0)
        self.stop = threading.Event()
        self.thread = threading.Thread(target=self.serve)
        self.thread.start()

    def close(self):
        self.stop.set()
        self.thread.join()
        self.socket.close()

    def serve(self):
        described = False
        due = time.monotonic()
        while not self.stop.is_set():
            try:
                data, address = self.socket.recvfrom(2048)
            except TimeoutError:
                pass
            else:
                (kind,) = struct.unpack_from("<H", data)
                if kind == 0:
                    self.socket.sendto(self.packet(1, self.info()), address)
                if kind == 4:
                    self.socket.sendto(self.packet(5, self.description()), address)
                    self.client, described = address, True
            if described and time.monotonic() >= due:
                due = time.monotonic() + PERIOD
                self.number += 1
                for packet in self.garbage:
                    self.socket.sendto(packet, self.client)
                self.socket.sendto(self.packet(7, self.frame()), self.client)

    @staticmethod
    def packet(kind, payload):
        return struct.pack("<HH", kind, len(payload)) + payload

    def sized(self, payload):
        return (struct.pack("<I", len(payload)) if self.version >= (4, 1) else b"") + payload

    def info(self):
        return b"Motive".ljust(256, b"\0") + bytes([3, 1, 0, 0]) + bytes([*self.version, 0, 0])

    def description(self):
        out = struct.pack("<I", len(BODIES))
        for name, number in BODIES.items():
            body = name.encode() + b"\0" + struct.pack("<II3f", number, 0, 0.0, 0.0, 0.0)
            body += struct.pack("<4f", 0, 0, 0, 1) if self.version >= (4, 2) else b""
            out += struct.pack("<I", 1) + self.sized(body + struct.pack("<I", 0))
        return out

    def frame(self, place=0.5, time=0.0):
        nothing = struct.pack("<I", 0) + self.sized(b"")
        angle = 0.01 * self.number
        poses = {7: ((9.0, 9.0, 9.0), about(1, 0.0)), 12: ((place, 0.1, -0.001 * self.number), about(1, angle))}
        bodies = b"".join(
            struct.pack("<I3f4ffH", number, *position, *rotation, 0.0, self.number not in self.lost)
            for number, (position, rotation) in poses.items()
        )
        rigid = struct.pack("<I", len(poses)) + self.sized(bodies)
        others = nothing * (5 if self.version >= (4, 1) else 4)
        suffix = struct.pack("<IIdQQQH", 0, 0, time + 1000.0 + PERIOD * self.number, 0, 0, 0, 0)
        return struct.pack("<I", self.number) + nothing * 2 + rigid + others + suffix


@pytest.fixture(params=[(3, 0), (4, 1)])
def server(request):
    server = MotiveServer(request.param)
    yield server
    server.close()


def watched(server, body="car"):
    return trackers.make("natnet", body=body, command_port=server.port).open()


def test_rigid_body_is_streamed_with_its_own_times(server):
    with watched(server) as stream:
        frames = [stream.read(5.0) for _ in range(60)]
    numbers = np.array([frame.frame for frame in frames])
    assert np.all(np.diff(numbers) == 1)
    assert all(frame.valid and frame.body == "car" for frame in frames)
    poses = np.array([frame.pose for frame in frames])
    assert poses[:, 0] == pytest.approx(np.full(60, 0.5))
    assert poses[:, 1] == pytest.approx(0.001 * numbers, abs=1e-6)
    assert np.unwrap(poses[:, 2]) == pytest.approx(np.unwrap(np.remainder(0.01 * numbers, 2 * np.pi)), abs=1e-5)
    assert np.diff([frame.source_time for frame in frames])[20:] == pytest.approx(PERIOD, abs=2e-3)
    assert all(frame.source_time <= frame.arrival_time <= time.monotonic() for frame in frames)


def test_body_that_is_lost_is_not_valid_and_garbage_is_survived(server):
    with watched(server) as stream:
        first = stream.read(5.0).frame
        server.lost = range(first + 10, first + 15)
        frames = [stream.read(5.0) for _ in range(30)]
        assert [frame.frame for frame in frames if not frame.valid] == list(server.lost)
        endless = struct.pack("<HHII", 7, 8, 1, 2**32 - 1)
        nowhere = server.packet(7, server.frame(time=math.nan))
        server.garbage = [b"", b"\x07", b"\x07\x00\x10\x00short", b"\x05\x00\x00\x00", b"\x01\x00", endless, nowhere]
        frames = [stream.read(1.0) for _ in range(60)]
    assert all(frame.valid for frame in frames)
    assert {int(after.frame - before.frame) for before, after in itertools.pairwise(frames)} == {1}


def test_what_others_send_is_no_frame(server):
    with watched(server) as stream, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.2", 0))
        assert stream.read(5.0).valid
        frames = []
        for _ in range(60):
            for packet in (server.packet(7, server.frame(place=100.0)), server.packet(5, bytes(4)), b"\x01"):
                other.sendto(packet, server.client)
            frames.append(stream.read(1.0))
    assert all(frame.valid and frame.pose[0] == pytest.approx(0.5) for frame in frames)
    assert {int(after.frame - before.frame) for before, after in itertools.pairwise(frames)} == {1}


def test_unknown_body_is_a_lost_link(server):
    with pytest.raises(LinkLost, match="no rigid body is called 'cat'; the server has: truck, car"):
        watched(server, "cat")


@pytest.mark.parametrize("angle", [-3.0, -0.5, 0.0, 1.0, 3.1])
def test_either_axis_up_gives_the_same_plane(angle):
    seen = Axes("z", heading_offset=0.1).planar((1.0, 2.0, 0.3), about(2, angle))
    assert seen == pytest.approx([1.0, 2.0, math.remainder(angle + 0.1, 2 * math.pi)])
    assert Axes("y", 0.001, 0.1).planar((1000.0, 300.0, -2000.0), about(1, angle)) == pytest.approx(seen)
