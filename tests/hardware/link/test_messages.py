"""Messages and buttons: bytes, meaning, and what is refused."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hardware.link.framing import FrameDecoder, encode
from hardware.link.messages import EXCLUSIVE, MESSAGES, Buttons, unpack
from hardware.link.serial_robot import buttons_of, control_of
from hardware.toy_car import CAR
from sysid_evo.errors import InvalidArgument, ShapeError
from tests.fixtures.golden_frames import CONVERSATION

VECTORS = [(m, b) for line in CONVERSATION for m, b in ((line.said, line.sent), (line.answer, line.received))]


@pytest.mark.parametrize("message, wire", VECTORS)
def test_golden_bytes_are_written_and_read(message, wire):
    assert encode(message.pack()).hex() == wire
    (body,) = FrameDecoder().feed(bytes.fromhex(wire))
    assert unpack(body) == message


@given(st.sampled_from(sorted(MESSAGES)), st.binary(max_size=31))
def test_what_can_be_read_is_what_would_be_written(kind, payload):
    message = unpack(bytes([kind]) + payload)
    assert message is None or message.pack() == bytes([kind]) + payload


@pytest.mark.parametrize("body", [b"", b"\x04", b"\x02" * 8, b"\x02" * 10, b"\x82" + bytes(19)])
def test_bytes_of_another_length_or_type_are_no_message(body):
    assert unpack(body) is None


@pytest.mark.parametrize("byte", range(256))
def test_buttons_need_their_complement_and_exclude_each_other(byte):
    body = bytearray(bytes.fromhex("02190302001a04a50f"))
    body[7] = byte
    low, high = byte & 0x0F, byte >> 4
    legal = low ^ high == 0x0F and low & 3 != 3 and low & 12 != 12
    assert (unpack(bytes(body)) is not None) == legal


@pytest.mark.parametrize("control", list(product((-1.0, 0.0, 1.0), repeat=2)))
def test_controls_and_buttons_map_one_to_one(control):
    buttons = buttons_of(np.array(control))
    assert control_of(buttons).tolist() == list(control)
    assert not any(buttons & pair == pair for pair in EXCLUSIVE)


def test_signs_are_those_of_the_car():
    assert CAR.control_names == ("drive", "steer")
    assert buttons_of(np.array([1.0, 1.0])) == Buttons.FORWARD | Buttons.LEFT
    assert buttons_of(np.array([-1.0, -1.0])) == Buttons.BACKWARD | Buttons.RIGHT


@pytest.mark.parametrize("control", [[np.nan, 0.0], [0.0, np.inf], [0.5, 0.0], [0.0, 2.0]])
def test_controls_between_the_levels_are_refused(control):
    with pytest.raises(InvalidArgument, match=r"expected -1, 0 or 1, got"):
        buttons_of(np.array(control))


def test_controls_of_another_shape_are_refused():
    with pytest.raises(ShapeError, match="control"):
        buttons_of(np.zeros(3))


def test_buttons_that_exclude_each_other_are_no_control():
    with pytest.raises(InvalidArgument, match="at most one"):
        control_of(Buttons.LEFT | Buttons.RIGHT)
