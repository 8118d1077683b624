"""Frames and messages: checksum, stuffing, a decoder that takes any bytes, and what buttons mean."""

from itertools import product

import numpy as np
import pytest
from cobs import cobs
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hardware.link.messages import ENCODED_MAX, EXCLUSIVE, MESSAGES, Buttons, FrameDecoder, checksum, encode, unpack
from hardware.link.serial_robot import buttons_of, control_of_buttons
from hardware.toy_car import CAR
from sysid_evo.errors import InvalidArgument, ShapeError
from tests.fixtures.golden_frames import CONVERSATION

BODIES = st.binary(min_size=1, max_size=30)


def test_checksum_has_the_check_value_of_the_catalogue():
    assert checksum(b"123456789") == 0x29B1


@given(BODIES)
def test_frame_holds_its_only_zero_at_the_end(body):
    frame = encode(body)
    assert frame.index(0) == len(frame) - 1 <= ENCODED_MAX


@given(st.lists(BODIES), st.integers(1, 7))
def test_bodies_come_back_however_the_stream_is_cut(bodies, cut):
    stream = b"".join(map(encode, bodies))
    decoder = FrameDecoder()
    received = [body for start in range(0, len(stream), cut) for body in decoder.feed(stream[start : start + cut])]
    assert received == bodies
    assert (decoder.frames, decoder.crc_errors, decoder.length_errors) == (len(bodies), 0, 0)


@given(BODIES, st.integers(1, 0xFFFF), st.data())
def test_no_damage_within_sixteen_bits_in_a_row_passes(body, damage, data):
    checked = body + checksum(body).to_bytes(2, "little")
    place = data.draw(st.integers(0, len(checked) - 2))
    bad = int.from_bytes(checked, "big") ^ damage << 8 * place
    decoder = FrameDecoder()
    assert decoder.feed(cobs.encode(bad.to_bytes(len(checked), "big")) + b"\0") == []
    assert decoder.crc_errors == 1


def _takes(stream, cut):
    decoder = FrameDecoder()
    for start in range(0, len(stream), cut):
        decoder.feed(stream[start : start + cut])
        assert len(decoder._partial) <= ENCODED_MAX
    assert decoder.feed(b"\0" + encode(b"after"))[-1] == b"after"
    pieces = sum(1 for piece in stream.split(b"\0") if piece)
    assert decoder.frames + decoder.crc_errors + decoder.length_errors == pieces + 1


@given(st.binary(max_size=400), st.integers(1, 400))
def test_decoder_takes_arbitrary_bytes_and_resynchronises_at_the_next_delimiter(stream, cut):
    _takes(stream, cut)


@pytest.mark.nightly
@settings(max_examples=100_000, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.binary(max_size=400), st.integers(1, 400))
def test_decoder_takes_a_hundred_thousand_streams(stream, cut):
    _takes(stream, cut)


def test_endless_frame_without_a_delimiter_counts_once():
    decoder = FrameDecoder()
    for _ in range(100):
        assert decoder.feed(b"\x07" * 50) == []
    assert decoder.feed(b"\0" + encode(b"x")) == [b"x"]
    assert (decoder.length_errors, decoder.crc_errors) == (1, 0)


@pytest.mark.parametrize("line", CONVERSATION)
def test_golden_bytes_are_written_and_read(line):
    for message, wire in ((line.said, line.sent), (line.answer, line.received)):
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


def test_buttons_need_their_complement_and_exclude_each_other():
    body = bytearray(bytes.fromhex("02190302001a04a50f"))
    for byte in range(256):
        body[7] = byte
        low, high = byte & 0x0F, byte >> 4
        legal = low ^ high == 0x0F and low & 3 != 3 and low & 12 != 12
        assert (unpack(bytes(body)) is not None) == legal, byte


def test_controls_and_buttons_map_one_to_one_with_the_signs_of_the_car():
    for control in product((-1.0, 0.0, 1.0), repeat=2):
        buttons = buttons_of(np.array(control))
        assert control_of_buttons(buttons).tolist() == list(control)
        assert not any(buttons & pair == pair for pair in EXCLUSIVE), control
    assert CAR.control_names == ("drive", "steer")
    assert buttons_of(np.array([1.0, 1.0])) == Buttons.FORWARD | Buttons.LEFT
    assert buttons_of(np.array([-1.0, -1.0])) == Buttons.BACKWARD | Buttons.RIGHT


@pytest.mark.parametrize("control", [[np.nan, 0.0], [0.0, np.inf], [0.5, 0.0], [0.0, 2.0]])
def test_controls_between_the_levels_are_refused(control):
    with pytest.raises(InvalidArgument, match=r"expected -1, 0 or 1, got"):
        buttons_of(np.array(control))


def test_controls_of_another_shape_and_buttons_that_exclude_each_other_are_refused():
    with pytest.raises(ShapeError, match="control"):
        buttons_of(np.zeros(3))
    with pytest.raises(InvalidArgument, match="at most one"):
        control_of_buttons(Buttons.LEFT | Buttons.RIGHT)
