"""The emulated tracker's datagrams, with and without faults."""

import math
import socket

import numpy as np
import pytest

from hardware.connection import Measurement
from hardware.trackers.udp import parse_message
from tests.system.rig.faults import Fault, FaultSchedule
from tests.system.rig.pose_stream import OTHER_BODY, OTHER_POSE, PoseStream

POSES = np.array([[0.01 * k, 0.02 * k, 0.1 * k] for k in range(5)])


def sent(*faults):
    """Stream five frames 5 ms apart, the first at 10 s, where the schedule starts."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(0.2)
        stream = PoseStream(receiver.getsockname(), "car", FaultSchedule(faults, 10.0), np.random.default_rng(1))
        for k, pose in enumerate(POSES):
            time = 10.0 + 0.005 * k
            stream.add(Measurement(time, time + 0.004, k, "anything", True, pose))
        stream.send(11.0)
        stream.close()
        messages = []
        while True:
            try:
                messages.append(parse_message(receiver.recv(4096)))
            except TimeoutError:
                return messages


def test_frames_arrive_as_they_were_taken():
    messages = sent()
    assert [message.frame for message in messages] == [0, 1, 2, 3, 4]
    assert [message.time for message in messages] == pytest.approx([10.0, 10.005, 10.01, 10.015, 10.02])
    assert {message.body for message in messages} == {"car"}
    np.testing.assert_array_equal([message.pose for message in messages], POSES)


def test_a_frame_is_sent_when_it_is_due():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.setblocking(False)
        stream = PoseStream(receiver.getsockname(), "car", FaultSchedule([], 10.0), np.random.default_rng(1))
        stream.add(Measurement(10.0, 10.004, 0, "car", True, POSES[0]))
        assert stream.due == 10.004
        stream.send(10.003)
        with pytest.raises(BlockingIOError):
            receiver.recv(4096)
        stream.send(10.004)
        assert parse_message(receiver.recv(4096)).frame == 0
        assert stream.due == math.inf
        stream.close()


def test_a_dropout_says_that_the_body_is_lost():
    assert [m.valid for m in sent(Fault(kind="dropout", at=0.004, duration=0.01))] == [True, False, False, True, True]


def test_silence_sends_nothing():
    assert [m.frame for m in sent(Fault(kind="silence", at=0.004, duration=0.01))] == [0, 3, 4]


def test_a_frozen_pose_keeps_coming_with_new_times():
    messages = sent(Fault(kind="frozen", at=0.004, duration=0.01))
    np.testing.assert_array_equal([m.pose for m in messages], POSES[[0, 0, 0, 3, 4]])
    assert [m.frame for m in messages] == [0, 1, 2, 3, 4]


def test_swapped_bodies_bear_each_other_s_names():
    messages = sent(Fault(kind="identity_swap", at=0.018, duration=1.0))
    assert [(m.frame, m.body) for m in messages[3:]] == [(3, "car"), (4, OTHER_BODY), (4, "car")]
    np.testing.assert_array_equal(messages[4].pose, POSES[4])
    np.testing.assert_array_equal(messages[5].pose, OTHER_POSE)


def test_a_flip_of_yaw_turns_the_heading_by_half_a_turn():
    messages = sent(Fault(kind="yaw_flip"))
    turned = [math.remainder(m.pose[2] - pose[2], 2.0 * math.pi) for m, pose in zip(messages, POSES, strict=True)]
    np.testing.assert_allclose(np.abs(turned), math.pi)
    np.testing.assert_array_equal([m.pose[:2] for m in messages], POSES[:, :2])
