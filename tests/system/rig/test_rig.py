"""The rig itself: faults on the wire, its journal, its car, its tracker's datagrams."""

import json
import math
import socket

import numpy as np
import pytest

from hardware.connection import Measurement
from hardware.emulation.cars import emulated_car
from hardware.trackers.udp import parse_message
from sysid_evo.errors import InvalidArgument, InvalidData
from tests.system.rig.faults import KINDS, Fault, FaultSchedule
from tests.system.rig.journal import Entry, RigLogReader, RigLogWriter, buttons_at, opened_after, read_journal
from tests.system.rig.moving_car import MOST_BEHIND, MovingCar
from tests.system.rig.pose_stream import OTHER_BODY, OTHER_POSE, PoseStream
from tests.system.rig.wire import Wire

FORWARD = np.array([1.0, 0.0])


def test_the_next_change_is_the_next_edge_of_any_fault():
    schedule = FaultSchedule([Fault(kind="unplug", at=2.0, duration=1.0), Fault(kind="reset", at=4.0)], start=100.0)
    assert [schedule.next_change(100.0 + t) for t in (0.0, 2.0, 3.5, 4.0)] == [102.0, 103.0, 104.0, math.inf]
    assert [schedule.active("unplug", 100.0 + t) for t in (1.9, 2.0, 2.9, 3.0)] == [False, True, True, False]
    assert [schedule.begun("reset", 100.0 + t) for t in (3.9, 4.0, 9.0)] == [0, 1, 1]


def test_a_fault_told_later_counts_from_then():
    schedule = FaultSchedule([], start=100.0)
    schedule.add(Fault(kind="silence", at=1.0, duration=2.0), now=150.0)
    assert [schedule.active("silence", t) for t in (150.0, 151.5, 153.5)] == [False, True, False]


def test_a_fault_of_every_kind_comes_back_when_it_is_written_and_a_senseless_one_is_refused():
    made = [Fault(kind=kind, at=1.0, **more) for kind in KINDS for more in ({}, {"duration": 2.0})]
    assert [Fault(**json.loads(fault.to_json())) for fault in made] == made
    for entries in ({"kind": "gremlin"}, {"kind": "stall", "at": -1.0}, {"kind": "unplug", "duration": 0.0}):
        with pytest.raises(InvalidArgument, match="fault"):
            Fault(**entries)


def test_a_stall_holds_everything_back_until_it_ends():
    wire = Wire(FaultSchedule([Fault(kind="stall", at=1.0, duration=2.0)], start=100.0))
    wire.push(b"before", 100.5)
    wire.push(b"within", 101.5)
    assert (wire.pull(102.9), wire.due, wire.pull(103.0)) == (b"before", 103.0, b"within")


PRESSES = [Entry(1.0, "buttons", 1), Entry(2.0, "buttons", 5), Entry(3.0, "buttons", 0), Entry(3.5, "out", "00")]


def test_a_journal_comes_back_in_order_and_a_reader_follows_it(tmp_path):
    path = tmp_path / "journal"
    writer, reader = RigLogWriter(path), RigLogReader(path)
    for count, entry in enumerate(PRESSES):
        assert reader.update() == PRESSES[:count]
        writer.note(entry.time, entry.event, entry.value)
    assert reader.update() == reader.update() == read_journal(path) == PRESSES
    writer.close()


def test_a_line_that_is_being_written_is_left_out_and_another_file_refused(tmp_path):
    path = tmp_path / "journal"
    path.write_text('{"time": 1.0, "event": "plug", "value": null}\n{"time": 2.')
    assert [entry.time for entry in read_journal(path)] == [1.0]
    path.write_text("hello\n")
    with pytest.raises(InvalidData, match="expected JSON lines"):
        read_journal(path)


def test_buttons_are_found_for_any_time_and_when_they_open_for_good():
    assert [buttons_at(PRESSES, time) for time in (0.5, 1.0, 2.5, 9.0)] == [0, 1, 5, 0]
    assert [opened_after(PRESSES, time) for time in (0.5, 2.5, 4.0)] == [3.0, 3.0, 4.0]
    assert opened_after([*PRESSES, Entry(5.0, "buttons", 2)], 4.0) is None
    assert opened_after(PRESSES[:2], 1.5) is None


def test_in_real_time_it_is_the_car_of_simulated_time():
    moving, simulated = MovingCar(emulated_car(), seed=3, start=50.0), emulated_car().connect(seed=3)
    simulated.send(FORWARD, valid_for=100.0)
    for now in 50.0 + 0.005 * np.arange(200):
        for frame in moving.move(now + 1e-6, FORWARD):
            expected = simulated.measure(1.0)
            np.testing.assert_array_equal(frame.pose, expected.pose)
            assert frame.source_time == pytest.approx(50.0 + expected.source_time)
            assert frame.arrival_time == pytest.approx(50.0 + expected.arrival_time)
    assert moving.frames == 200


def test_missed_steps_are_caught_up_and_a_process_that_slept_goes_on_from_now():
    moving = MovingCar(emulated_car(), seed=3, start=50.0)
    assert (len(list(moving.move(50.5001, FORWARD))), moving.lateness) == (101, pytest.approx(0.5001))
    assert moving.due == pytest.approx(50.505)
    slept = MovingCar(emulated_car(), seed=3, start=50.0)
    list(slept.move(50.0, FORWARD))
    frames = list(slept.move(50.0 + 100.0 * MOST_BEHIND, FORWARD))
    assert len(frames) <= 2
    assert frames[-1].source_time == pytest.approx(50.0 + 100.0 * MOST_BEHIND, abs=0.006)
    assert slept.given_up == pytest.approx(100.0 * MOST_BEHIND / 0.005, abs=2)


POSES = np.array([[0.01 * k, 0.02 * k, 0.1 * k] for k in range(5)])


@pytest.fixture
def stream_to():
    """Makes the emulated tracker, which begins at 10 s; its datagrams are read by ``receive`` beside it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.setblocking(False)

        def make(*faults):
            return PoseStream(receiver.getsockname(), "car", FaultSchedule(faults, 10.0))

        def receive():
            """Return what has come; on this machine a datagram is there once it is sent."""
            messages = []
            while True:
                try:
                    messages.append(parse_message(receiver.recv(4096)))
                except BlockingIOError:
                    return messages

        make.receive = receive
        yield make


@pytest.fixture
def sent(stream_to):
    """Streams five frames 5 ms apart."""

    def send(*faults):
        stream = stream_to(*faults)
        for k, pose in enumerate(POSES):
            time = 10.0 + 0.005 * k
            stream.add(Measurement(time, time + 0.004, k, "anything", True, pose))
        stream.send(11.0)
        stream.close()
        return stream_to.receive()

    return send


def test_frames_arrive_as_they_were_taken(sent):
    messages = sent()
    assert [message.frame for message in messages] == [0, 1, 2, 3, 4]
    assert [message.time for message in messages] == pytest.approx([10.0, 10.005, 10.01, 10.015, 10.02])
    assert {message.body for message in messages} == {"car"}
    np.testing.assert_array_equal([message.pose for message in messages], POSES)


def test_a_frame_is_sent_when_it_is_due(stream_to):
    stream = stream_to()
    stream.add(Measurement(10.0, 10.004, 0, "car", True, POSES[0]))
    assert stream.due == 10.004
    stream.send(10.003)
    assert stream_to.receive() == []
    stream.send(10.004)
    assert [message.frame for message in stream_to.receive()] == [0]
    assert stream.due == math.inf
    stream.close()


def test_a_dropout_says_that_the_body_is_lost_and_silence_sends_nothing(sent):
    assert [m.valid for m in sent(Fault(kind="dropout", at=0.004, duration=0.01))] == [True, False, False, True, True]
    assert [m.frame for m in sent(Fault(kind="silence", at=0.004, duration=0.01))] == [0, 3, 4]


def test_a_frozen_pose_keeps_coming_with_new_times(sent):
    messages = sent(Fault(kind="frozen", at=0.004, duration=0.01))
    np.testing.assert_array_equal([m.pose for m in messages], POSES[[0, 0, 0, 3, 4]])
    assert [m.frame for m in messages] == [0, 1, 2, 3, 4]


def test_swapped_bodies_bear_each_other_s_names(sent):
    messages = sent(Fault(kind="identity_swap", at=0.018, duration=1.0))
    assert [(m.frame, m.body) for m in messages[3:]] == [(3, "car"), (4, OTHER_BODY), (4, "car")]
    np.testing.assert_array_equal(messages[4].pose, POSES[4])
    np.testing.assert_array_equal(messages[5].pose, OTHER_POSE)


def test_a_flip_of_yaw_turns_the_heading_by_half_a_turn(sent):
    messages = sent(Fault(kind="yaw_flip"))
    turned = [math.remainder(m.pose[2] - pose[2], 2.0 * math.pi) for m, pose in zip(messages, POSES, strict=True)]
    np.testing.assert_allclose(np.abs(turned), math.pi)
    np.testing.assert_array_equal([m.pose[:2] for m in messages], POSES[:, :2])
