"""The compiled core: the bytes of the Python side, any bytes at all, and how it is built."""

import ctypes
import struct
import subprocess
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hardware.link.messages import (
    Buttons,
    CommandMessage,
    FrameDecoder,
    Hello,
    HelloAcknowledgement,
    StatusMessage,
    Stop,
    checksum,
    encode,
    unpack,
)
from sysid_evo.errors import InvalidArgument
from tests.benchmarks.link.__main__ import RATES, damage
from tests.fixtures.golden_frames import CONVERSATION, ROBOT
from tests.system.rig.build import build_c, build_core
from tests.system.rig.core import FirmwareCore

SANITIZE = ("-O1", "-g", "-Werror", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
SESSION = 39022  # of the first HELLO with nonce 0


def test_golden_conversation_is_held_byte_for_byte():
    core = FirmwareCore(**ROBOT)
    for line in CONVERSATION:
        core.receive(bytes.fromhex(line.sent), line.now_ms)
        assert core.transmit().hex() == line.received


@given(st.binary(min_size=1, max_size=30))
def test_both_sides_write_the_same_frames(body):
    library = ctypes.CDLL(str(build_core()))
    out = ctypes.create_string_buffer(len(body) + 4)
    size = library.rcb_encode(body, ctypes.c_size_t(len(body)), out)
    assert out.raw[:size] == encode(body)
    library.rcb_crc.restype = ctypes.c_uint16
    assert library.rcb_crc(b"123456789", ctypes.c_size_t(9)) == checksum(b"123456789") == 0x29B1


def test_output_that_is_not_fetched_is_whole_frames():
    core = FirmwareCore()
    for now in range(0, 2000, 100):
        core.tick(now)
    decoder = FrameDecoder()
    assert [unpack(body).clock_ms for body in decoder.feed(core.transmit())] == [100, 200, 300]
    assert decoder.crc_errors == decoder.length_errors == 0


def test_core_is_compiled_once_and_without_a_warning():
    assert build_core() == build_core()
    assert build_c("strict.so", (), ("-Werror", "-shared", "-fPIC")).is_file()


def test_missing_compiler_is_named(monkeypatch):
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(InvalidArgument, match=r"C compiler.*no-such-compiler.*CC"):
        build_core()


def test_error_of_the_compiler_is_shown(tmp_path):
    broken = tmp_path / "broken.c"
    broken.write_text("int broken(void) { return nothing; }\n")
    with pytest.raises(InvalidArgument, match=r"broken\.c:1.*nothing"):
        build_c("broken.so", (broken,), ("-shared", "-fPIC"))


@pytest.fixture(scope="module")
def replayer():
    """A process that feeds streams to the core under address and undefined-behaviour sanitizers."""
    program = build_c("replay", (Path(__file__).with_name("replay.c"),), SANITIZE)
    with subprocess.Popen([program], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        yield process
        process.stdin.close()
        assert process.wait(10) == 0


_FRAMES = st.one_of(
    st.builds(Hello, st.sampled_from([1, 1, 2]), st.just(0), st.integers(0, 2)),
    st.builds(
        CommandMessage,
        st.just(SESSION),
        st.integers(0, 20),
        st.integers(0, 400),
        st.sampled_from([Buttons.NONE, Buttons.FORWARD, Buttons.BACKWARD | Buttons.RIGHT]),
        st.integers(0, 16),
    ),
    st.builds(Stop, st.just(SESSION), st.just(0)),
).map(lambda message: encode(message.pack()))
_LONG = st.binary(min_size=30, max_size=80).map(lambda data: data.replace(b"\0", b"\1"))
_BYTES = st.one_of(_FRAMES, _FRAMES, st.binary(max_size=80), _LONG)
_CHUNKS = st.lists(st.tuples(st.integers(0, 255), _BYTES), max_size=12)


def _survives(process, chunks):
    """Feed ``chunks`` to a fresh core; compare its counts with the Python decoder's and return what it said."""
    reading, writing = process.stdout, process.stdin
    stream = b"".join(bytes([wait, len(data)]) + data for wait, data in chunks)
    writing.write(struct.pack("<I", len(stream)) + stream)
    writing.flush()
    (size,) = struct.unpack("<I", _exactly(reading, 4))
    decoder = FrameDecoder()
    said = tuple(unpack(body) for body in decoder.feed(_exactly(reading, size)))
    assert decoder.crc_errors == decoder.length_errors == 0
    python = FrameDecoder()
    bodies = python.feed(b"".join(data for _, data in chunks))
    last = said[-1]
    assert isinstance(last, StatusMessage)
    assert last.crc == python.crc_errors
    assert last.length == python.length_errors + sum(not _is_for_robots(body) for body in bodies)
    return said


def _is_for_robots(body):
    message = unpack(body)
    return isinstance(message, Hello | Stop) or (
        isinstance(message, CommandMessage) and 1 <= message.time_to_live <= 15
    )


def _exactly(stream, size):
    data = stream.read(size)
    assert len(data) == size, "the core stopped: see the sanitizer's report on stderr"
    return data


def test_streams_of_the_sanitized_core_reach_driving(replayer):
    chunks = [
        (1, encode(Hello(1, 0, 0).pack())),
        (1, encode(CommandMessage(SESSION, 1, 0, Buttons.NONE, 15).pack())),
        (1, encode(CommandMessage(SESSION, 2, 0, Buttons.FORWARD, 15).pack())),
    ]
    said = _survives(replayer, chunks)
    assert {message.session for message in said if isinstance(message, HelloAcknowledgement)} == {SESSION}
    assert any(message.buttons for message in said if isinstance(message, StatusMessage))


@pytest.mark.parametrize("size", [1, 2, 32, 33, 34, 35, 254])
def test_frames_up_to_the_longest_and_beyond_are_counted_alike(replayer, size):
    last = _survives(replayer, [(0, b"\x01" * size + b"\0"), (0, bytes([size]) + b"\x07" * (size - 1)), (0, b"\0")])[-1]
    assert last.crc + last.length == 2


@settings(suppress_health_check=list(HealthCheck))
@given(_CHUNKS)
def test_core_takes_arbitrary_bytes_under_sanitizers(replayer, chunks):
    _survives(replayer, chunks)


@pytest.mark.nightly
@settings(max_examples=100_000, suppress_health_check=list(HealthCheck))
@given(_CHUNKS)
def test_core_takes_a_hundred_thousand_streams_under_sanitizers(replayer, chunks):
    _survives(replayer, chunks)


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("frames", [100_000, pytest.param(10**7, marks=pytest.mark.nightly)])
def test_damaged_frames_are_refused_and_intact_ones_after_a_delimiter_accepted(frames, rate):
    found = damage(frames, rate, seed=1)
    assert found.damaged == pytest.approx(found.frames * (1.0 - (1.0 - rate) ** 13), rel=0.1)
    assert (found.wrong, found.missed) == (0, 0)
    assert found.accepted > 0.2 * found.frames
