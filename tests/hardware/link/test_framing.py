"""Frames: checksum, stuffing, and a decoder that takes any bytes."""

import pytest
from cobs import cobs
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hardware.link.framing import ENCODED_MAX, FrameDecoder, checksum, encode

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
        assert decoder.buffered <= ENCODED_MAX
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
