"""RCB/1: frames COBS(type, payload, CRC-16/CCITT-FALSE) and a zero byte; messages, their content, little-endian."""

from __future__ import annotations

import struct
from abc import ABC
from binascii import crc_hqx
from dataclasses import dataclass, fields
from enum import IntEnum, IntFlag
from typing import Any, ClassVar, Self

DECODED_MAX = 32
ENCODED_MAX = DECODED_MAX + 1
CRC_SIZE = 2
DELIMITER = 0


def checksum(data: bytes) -> int:
    """Return the CRC-16/CCITT-FALSE of ``data``."""
    return crc_hqx(data, 0xFFFF)


def encode(body: bytes) -> bytes:
    """Return the frame of ``body``, a type and its payload of together at most 30 bytes."""
    from cobs import cobs

    return cobs.encode(body + checksum(body).to_bytes(CRC_SIZE, "little")) + bytes([DELIMITER])


class FrameDecoder:
    """Splits a stream of bytes into frames and drops the damaged ones.

    It accepts any bytes without an error and keeps at most one frame of them. ``crc_errors`` counts frames of a legal
    length with a wrong checksum, ``length_errors`` those that are too long, too short or not COBS; after either,
    decoding restarts at the next delimiter.
    """

    def __init__(self) -> None:
        self.frames = 0
        self.crc_errors = 0
        self.length_errors = 0
        self._partial = bytearray()
        self._overlong = False

    def feed(self, data: bytes) -> list[bytes]:
        """Return the bodies (type and payload) of the frames that ``data`` completes, in order."""
        *ends, rest = data.split(bytes([DELIMITER]))
        bodies = []
        for piece in ends:
            self._keep(piece)
            body = self._finish()
            if body is not None:
                bodies.append(body)
        self._keep(rest)
        return bodies

    def _keep(self, piece: bytes) -> None:
        self._overlong = self._overlong or len(self._partial) + len(piece) > ENCODED_MAX
        self._partial += piece[: ENCODED_MAX - len(self._partial)]

    def _finish(self) -> bytes | None:
        from cobs import cobs

        encoded, overlong = bytes(self._partial), self._overlong
        self._partial.clear()
        self._overlong = False
        if not encoded:
            return None
        try:
            decoded = b"" if overlong else cobs.decode(encoded)
        except cobs.DecodeError:
            decoded = b""
        body, check = decoded[:-CRC_SIZE], decoded[-CRC_SIZE:]
        if not body:
            self.length_errors += 1
            return None
        if checksum(body) != int.from_bytes(check, "little"):
            self.crc_errors += 1
            return None
        self.frames += 1
        return body


MAJOR, MINOR = 1, 0
TIME_TO_LIVE_UNIT = 0.01  # s
BUTTONS = 0x0F


class Buttons(IntFlag):
    """The four buttons of the remote control that the robot's outputs close."""

    NONE = 0
    FORWARD = 1
    BACKWARD = 2
    LEFT = 4
    RIGHT = 8


class State(IntEnum):
    """Mode of the robot: no session, a session without a command, under command, stopped by its deadman."""

    WAITING = 0
    NEUTRAL = 1
    DRIVING = 2
    TRIPPED = 3


EXCLUSIVE = (Buttons.FORWARD | Buttons.BACKWARD, Buttons.LEFT | Buttons.RIGHT)


@dataclass(frozen=True)
class Message(ABC):
    """A message; its fields are in the order of the wire, and a field ``buttons`` is followed by its complement."""

    type: ClassVar[int]
    layout: ClassVar[struct.Struct]

    def pack(self) -> bytes:
        """Return type and payload."""
        values = [
            _guarded(value) if name == "buttons" else value
            for name, value in ((field.name, getattr(self, field.name)) for field in fields(self))
        ]
        return bytes([self.type]) + self.layout.pack(*values)

    @classmethod
    def unpack(cls, payload: bytes) -> Self | None:
        """Inverse of `pack` without the type; None if length, buttons or state are not those of this message."""
        if len(payload) != cls.layout.size:
            return None
        names = (field.name for field in fields(cls))
        values: dict[str, Any] = dict(zip(names, cls.layout.unpack(payload), strict=True))
        if "buttons" in values:
            buttons = Buttons(values["buttons"] & BUTTONS)
            if values["buttons"] != _guarded(buttons) or any(buttons & pair == pair for pair in EXCLUSIVE):
                return None
            values["buttons"] = buttons
        if "state" in values:
            if values["state"] > max(State):
                return None
            values["state"] = State(values["state"])
        return cls(**values)


@dataclass(frozen=True)
class Hello(Message):
    """Asks for a new session; ``nonce`` is different for each."""

    type = 0x01
    layout = struct.Struct("<BBI")

    major: int
    minor: int
    nonce: int


@dataclass(frozen=True)
class CommandMessage(Message):
    """Closes ``buttons`` for ``time_to_live`` (10 ms); ``host_ms`` is the host's clock in ms, modulo 65536."""

    type = 0x02
    layout = struct.Struct("<HHHBB")

    session: int
    sequence: int
    host_ms: int
    buttons: Buttons
    time_to_live: int


@dataclass(frozen=True)
class Stop(Message):
    """Opens all buttons and ends any session."""

    type = 0x03
    layout = struct.Struct("<HH")

    session: int
    sequence: int


@dataclass(frozen=True)
class HelloAcknowledgement(Message):
    """Answers a HELLO with the robot's identity and, if the major versions agree, a session other than 0."""

    type = 0x81
    layout = struct.Struct("<BBHBBHIH")

    major: int
    minor: int
    firmware_build: int
    max_time_to_live: int
    reset_cause: int
    boot_count: int
    nonce: int
    session: int


@dataclass(frozen=True)
class StatusMessage(Message):
    """Mode of the robot, its clock in ms, and its counters of refused commands since it started (modulo 65536)."""

    type = 0x82
    layout = struct.Struct("<HHBBIHHHHH")

    session: int
    last_sequence: int
    state: State
    buttons: Buttons
    clock_ms: int
    crc: int
    length: int
    duplicate: int
    late: int
    trips: int

    @property
    def counters(self) -> dict[str, int]:
        """The five counters by name."""
        return {name: getattr(self, name) for name in ("crc", "length", "duplicate", "late", "trips")}


MESSAGES: dict[int, type[Message]] = {
    message.type: message for message in (Hello, CommandMessage, Stop, HelloAcknowledgement, StatusMessage)
}


def unpack(body: bytes) -> Message | None:
    """Return the message in ``body`` (type and payload), or None if it is none of RCB/1."""
    message = MESSAGES.get(body[0]) if body else None
    return None if message is None else message.unpack(body[1:])


def _guarded(buttons: int) -> int:
    return buttons | (~buttons & BUTTONS) << 4
