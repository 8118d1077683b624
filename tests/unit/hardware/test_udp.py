"""The UDP/JSON stream: good datagrams become frames, all others are counted."""

import json
import math
import select
import socket
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hardware.trackers.udp import FrameMessage, UdpTracker, parse_message
from sysid_evo.errors import InvalidData, LinkLost
from sysid_evo.registry import trackers
from tests.system.rig.pose_stream import format_message

TEXT = st.sampled_from('car \\"\0ü€😀\ud800')  # building the table of all characters takes seconds
numbers = st.floats(-1e6, 1e6)
frames = st.builds(
    FrameMessage,
    time=numbers,
    frame=st.integers(0, 2**63 - 1),
    body=st.text(TEXT, max_size=20),
    valid=st.booleans(),
    pose=st.tuples(numbers, numbers, numbers).map(np.array),
)


class Sender:
    def __init__(self, opened, address):
        self.socket, self.address = opened, address

    def send(self, data):
        self.socket.sendto(data, self.address)

    def frame(self, time, frame, body="car", valid=True):
        self.send(format_message(FrameMessage(time, frame, body, valid, np.array([1.0, 2.0, 0.5]))))


@pytest.fixture(params=[{"clock": "source"}])
def stream(request):
    with trackers.make("udp", body="car", port=0, **request.param).open() as opened:
        yield opened


@pytest.fixture
def sender(stream):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        yield Sender(opened, stream.address)


@given(frames)
def test_message_comes_back_as_it_was_written(message):
    back = parse_message(format_message(message))
    assert (back.time, back.frame, back.body, back.valid) == (message.time, message.frame, message.body, message.valid)
    assert np.array_equal(back.pose, message.pose if message.valid else [math.nan] * 3, equal_nan=True)


@given(
    st.one_of(
        st.binary(max_size=1100),
        st.recursive(
            st.none() | st.booleans() | st.floats() | st.integers() | st.text(TEXT, max_size=5),
            lambda inner: st.lists(inner) | st.dictionaries(st.sampled_from(["time", "frame", "pose", "body"]), inner),
        ).map(lambda value: json.dumps(value).encode()),
    )
)
def test_arbitrary_bytes_are_a_frame_or_invalid_data(data):
    try:
        message = parse_message(data)
    except InvalidData:
        return
    assert math.isfinite(message.time)
    assert np.all(np.isfinite(message.pose)) == message.valid


GOOD = {"time": 1.0, "frame": 1, "body": "car", "valid": True, "pose": [0.0, 0.0, 0.0]}


@pytest.mark.parametrize(
    "change",
    [
        {"time": math.nan}, {"time": 10**400}, {"time": True}, {"time": "1"}, {"frame": 1.5}, {"frame": -1},
        {"frame": True}, {"body": None}, {"valid": 1}, {"pose": None}, {"pose": [0.0, 0.0]},
        {"pose": [0.0, math.inf, 0.0]}, {"pose": [0.0, [0.0], 0.0]}, {"pose": {"x": 0.0}},
    ],
)  # fmt: skip
def test_wrong_field_is_refused(change):
    assert parse_message(json.dumps(GOOD).encode()).frame == 1
    with pytest.raises(InvalidData, match="expected"):
        parse_message(json.dumps(GOOD | change).encode())


def test_deeply_nested_and_endless_messages_are_refused():
    for data in (b"[" * 1024, b'{"a":' * 200, b" " * 60_000, b"9" * 1000):
        with pytest.raises(InvalidData):
            parse_message(data)


def test_frames_come_in_turn_with_source_times_on_the_hosts_clock(stream, sender):
    begin = time.monotonic()
    for number in range(5):
        sender.frame(100.0 + 0.005 * number, number)
    read = [stream.read(1.0) for _ in range(5)]
    assert [frame.frame for frame in read] == [0, 1, 2, 3, 4]
    assert np.diff([frame.source_time for frame in read]) == pytest.approx(0.005, abs=0.01)
    assert all(begin <= frame.arrival_time <= time.monotonic() for frame in read)
    assert all(frame.source_time <= frame.arrival_time for frame in read)
    assert np.array_equal(read[0].pose, [1.0, 2.0, 0.5])
    assert stream.read(0.0) is None


@pytest.mark.parametrize("stream", [{"clock": "host"}], indirect=True)
def test_times_on_the_hosts_clock_are_taken_as_they_are(stream, sender):
    now = time.monotonic()
    sender.frame(now - 0.004, 1)
    sender.frame(now + 60.0, 2)
    assert stream.read(1.0).source_time == now - 0.004
    assert stream.read(0.05) is None


def test_what_is_no_frame_of_the_body_is_skipped(stream, sender):
    sender.send(b"\xff\x00garbage")
    sender.send(b"[" * 1000)
    sender.send(b"")
    sender.frame(1.0, 1, body="other car")
    sender.frame(1.1, 2)
    sender.frame(1.1, 2)
    sender.frame(1.05, 1)
    sender.frame(1.2, 3, valid=False)
    assert [stream.read(1.0).frame for _ in range(2)] == [2, 3]
    assert stream.read(0.05) is None


def test_restarted_source_is_followed(stream, sender):
    for number in range(3):
        sender.frame(500.0 + number, 100 + number)
    sender.frame(0.1, 0)
    assert [stream.read(1.0).frame for _ in range(4)] == [100, 101, 102, 0]


def test_descriptor_is_readable_while_a_frame_waits(stream, sender):
    assert select.select([stream], [], [], 0.0)[0] == []
    sender.frame(1.0, 1)
    assert select.select([stream], [], [], 1.0)[0] == [stream]


def test_flood_of_garbage_does_not_hold_up_a_read(stream, sender):
    for _ in range(500):
        sender.send(b"garbage")
    begin = time.monotonic()
    assert stream.read(0.0) is None
    assert stream.read(0.02) is None
    assert time.monotonic() - begin < 0.5


@pytest.mark.parametrize("stream", [{"sender": "127.0.0.2"}], indirect=True)
def test_other_senders_are_refused(stream, sender):
    sender.frame(1.0, 1)
    assert stream.read(0.05) is None


def test_taken_port_and_closed_stream_are_a_lost_link(stream):
    with pytest.raises(LinkLost, match=f"listen on 127.0.0.1:{stream.address[1]}"):
        UdpTracker("car", stream.address[1]).open()
    stream.close()
    stream.close()
    with pytest.raises(LinkLost, match="closed"):
        stream.read(0.0)
