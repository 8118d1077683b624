"""The serial robot on a pseudo-terminal, with the compiled firmware at its other end."""

import os
import select
import threading
import time
import tty
from collections import deque
from dataclasses import replace

import numpy as np
import pytest

from hardware.connection import Measurement
from hardware.link.messages import FrameDecoder, HelloAcknowledgement, State, encode, unpack
from hardware.link.port import SerialPort
from hardware.link.serial_robot import SerialRobot
from hardware.robot import Robot
from hardware.toy_car import CAR
from hardware.trackers.tracker import Tracker, TrackerStream
from sysid_evo.errors import IncompatibleRobot, InvalidArgument, LinkLost, UnknownName
from sysid_evo.registry import make_robot, trackers
from tests.system.rig.core import FirmwareCore

FORWARD = np.array([1.0, 0.0])
LIFE = 0.15


class Remote:
    """A remote control on a pseudo-terminal: the core, its clock and its wire, in a thread."""

    def __init__(self):
        self.core, self.said = FirmwareCore(), []
        self._decoder = FrameDecoder()
        self.deaf, self.speak_version_3, self._done = (threading.Event() for _ in range(3))
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.port = os.ttyname(self._slave)
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self):
        while not self._done.is_set():
            readable, _, _ = select.select([self._master], [], [], 0.002)
            if self.deaf.is_set():
                continue
            now = time.monotonic_ns() // 1_000_000 % 2**32
            if readable:
                self.core.receive(os.read(self._master, 4096), now)
            self.core.tick(now)
            spoken = self.core.transmit()
            self.said += filter(None, map(unpack, self._decoder.feed(spoken)))
            if self.speak_version_3.is_set():
                spoken = b"".join(_of_version_3(body) for body in FrameDecoder().feed(spoken))
            os.write(self._master, spoken)

    def unplug(self):
        """Let both ends of the wire go; the port hangs up."""
        self._done.set()
        self._thread.join()
        if self._master >= 0:
            os.close(self._master)
            os.close(self._slave)
            self._master = -1


def _of_version_3(body):
    message = unpack(body)
    if not isinstance(message, HelloAcknowledgement):
        return b""
    return encode(replace(message, major=3, session=0).pack())


@pytest.fixture
def remote():
    made = Remote()
    yield made
    made.unplug()


@pytest.fixture
def connection(remote):
    with SerialRobot(port=remote.port).connect() as connection:
        yield connection


def until(condition, act):
    """Repeat ``act`` until ``condition`` holds, for 2 s at most."""
    end = time.monotonic() + 2.0
    while not condition():
        assert time.monotonic() < end
        act()


def drive(connection):
    connection.send(FORWARD, valid_for=LIFE)
    connection.measure(0.02)


def assert_a_stop_ends(session, remote):
    """Repeat ``session`` until a STOP opens the buttons at its end; in a pause of the machine the deadman does."""
    trips = 0
    for _ in range(5):
        session()
        until(lambda: remote.said[-1].state == State.WAITING, lambda: time.sleep(0.002))
        assert remote.core.buttons == 0
        before, trips = trips, remote.said[-1].trips
        if trips == before:
            return
    pytest.fail(f"the deadman opened the buttons {trips} times")


class Queue(TrackerStream):
    """Frames from a list, readable while there are some."""

    def __init__(self, frames):
        self._frames = deque(frames)
        self._read, self._write = os.pipe()
        os.write(self._write, b"." * len(frames))
        self.closed = False

    def read(self, timeout):
        if not self._frames:
            return None
        os.read(self._read, 1)
        return self._frames.popleft()

    def fileno(self):
        return self._read

    def close(self):
        if not self.closed:
            os.close(self._read)
            os.close(self._write)
        self.closed = True


class Listed(Tracker):
    """A tracker that has seen ``count`` frames of the body."""

    def __init__(self, *, count=3):
        self.name, self.body = "listed", "car"
        self.frames = [Measurement(float(k), float(k), k, self.body, True, np.zeros(3)) for k in range(count)]

    def open(self):
        self.stream = Queue(self.frames)
        return self.stream


def test_robot_of_the_registry_keeps_the_contract_and_a_file_describes_another(tmp_path, register):
    robot = make_robot("serial")
    assert isinstance(robot, Robot)
    assert robot.system == CAR
    assert robot.dynamics is None
    register(trackers, "listed", Listed)
    file = tmp_path / "car.toml"
    file.write_text('driver = "serial"\nname = "red car"\nport = "/dev/car"\n[tracker]\ndriver = "listed"\ncount = 5\n')
    robot = make_robot(str(file))
    assert (robot.name, robot.port, len(robot.tracker.frames)) == ("red car", "/dev/car", 5)


def test_wrong_descriptions_of_a_robot_are_refused():
    with pytest.raises(InvalidArgument, match=r'driver = "NAME"'):
        SerialRobot(tracker={"port": 1})
    with pytest.raises(UnknownName, match="tracker"):
        SerialRobot(tracker={"driver": "no_such_tracker"})
    with pytest.raises(InvalidArgument, match="patience"):
        SerialRobot(patience=0.0)


def test_command_closes_buttons_and_the_end_of_the_session_opens_them(remote):
    connection = None

    def session():
        nonlocal connection
        with SerialRobot(port=remote.port).connect() as connection:
            until(lambda: remote.core.buttons == 1, lambda: drive(connection))
            until(lambda: connection.status.state == "driving", lambda: drive(connection))
            assert connection.status.control.tolist() == [1.0, 0.0]
            assert 0.0 < connection.round_trip < 0.25

    assert_a_stop_ends(session, remote)
    connection.close()
    with pytest.raises(LinkLost, match="closed"):
        connection.send(FORWARD, valid_for=LIFE)


def test_exception_in_the_session_opens_the_buttons(remote):
    def fail():
        with SerialRobot(port=remote.port).connect() as connection:
            until(lambda: remote.core.buttons == 1, lambda: drive(connection))
            raise ZeroDivisionError

    def session():
        with pytest.raises(ZeroDivisionError):
            fail()

    assert_a_stop_ends(session, remote)


def test_frames_of_the_tracker_come_in_turn(remote):
    tracker = Listed()
    with SerialRobot(port=remote.port, tracker=tracker).connect() as connection:
        assert [connection.measure(1.0).frame for _ in range(3)] == [0, 1, 2]
        assert connection.measure(0.0) is None
    assert tracker.stream.closed


def test_tracker_is_closed_if_the_robot_cannot_be_reached(tmp_path):
    tracker = Listed()
    with pytest.raises(LinkLost, match=r"within 0\.1 s.*no such device"):
        SerialRobot(port=str(tmp_path / "none"), tracker=tracker, patience=0.1).connect()
    assert tracker.stream.closed


def test_illegal_control_is_refused_and_nothing_is_sent(connection):
    for control in ([np.nan, 0.0], [0.5, 0.0]):
        with pytest.raises(InvalidArgument, match="drive"):
            connection.send(np.array(control), valid_for=LIFE)
    assert connection._session._sequence == 0


def test_unplugged_port_is_a_lost_link_at_once_and_for_good(remote, connection):
    until(lambda: remote.core.buttons == 1, lambda: drive(connection))
    remote.unplug()
    before = time.monotonic()
    with pytest.raises(LinkLost, match="gone"):
        connection.measure(5.0)
    with pytest.raises(LinkLost, match="gone"):
        connection.send(FORWARD, valid_for=LIFE)
    assert time.monotonic() - before < 1.0


def test_silent_robot_is_a_lost_link(remote, connection):
    remote.deaf.set()
    before = time.monotonic()
    with pytest.raises(LinkLost, match="silent"):
        until(lambda: False, lambda: drive(connection))
    assert time.monotonic() - before < 1.0


def test_pause_of_the_host_trips_the_robot_and_is_told(remote, connection):
    until(lambda: remote.core.buttons == 1, lambda: drive(connection))
    time.sleep(0.4)
    with pytest.raises(LinkLost, match=r"tripped.*longest pause between two was \d"):
        connection.send(FORWARD, valid_for=LIFE)
    connection.close()
    with SerialRobot(port=remote.port).connect() as connection:
        assert remote.core.buttons == 0
        until(lambda: remote.core.buttons == 1, lambda: drive(connection))


@pytest.mark.usefixtures("connection")
def test_port_belongs_to_one_program(remote):
    with pytest.raises(LinkLost, match="another program uses it"):
        SerialRobot(port=remote.port, patience=0.1).connect()


def test_robot_that_appears_while_connecting_is_found(remote, tmp_path):
    link = tmp_path / "by-id"
    timer = threading.Timer(0.3, lambda: link.symlink_to(remote.port))
    timer.start()
    SerialRobot(port=str(link), patience=5.0).connect().close()
    timer.join()


def test_device_that_does_not_answer_is_given_up(remote):
    remote.deaf.set()
    with pytest.raises(LinkLost, match="does not answer"):
        SerialRobot(port=remote.port, patience=0.3).connect()


def test_other_major_version_is_refused_at_once(remote):
    remote.speak_version_3.set()
    before = time.monotonic()
    with pytest.raises(IncompatibleRobot, match=r"RCB/3\.0.*RCB/1\.0"):
        SerialRobot(port=remote.port, patience=30.0).connect()
    assert time.monotonic() - before < 10.0


def test_port_without_a_name_must_be_the_only_one(monkeypatch, tmp_path):
    monkeypatch.setattr("hardware.link.port.BY_ID", tmp_path)
    with pytest.raises(InvalidArgument, match="found none"):
        SerialRobot().connect()
    (tmp_path / "usb-one").touch()
    (tmp_path / "usb-two").touch()
    with pytest.raises(InvalidArgument, match=r"usb-one, .*usb-two"):
        SerialRobot().connect()


def test_writing_to_a_full_port_does_not_block(remote):
    remote.deaf.set()
    port = SerialPort(remote.port)
    frames = encode(b"0123456789")
    for _ in range(2000):
        port.write(frames)
    port.discard()
    port.close()
