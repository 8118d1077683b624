"""The records of a journal: what they hold, and how it is packed.

A record is its length (u32, of the payload), its kind (u8), the payload and a CRC-32 of all before it;
little-endian throughout. Text in a payload is UTF-8 behind its length.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, TypeAlias

import numpy as np

from hardware.listener import Command, RobotStatus
from hardware.measurement import Measurement
from sysid_evo.arrays import Array
from sysid_evo.errors import InvalidData
from sysid_evo.system import System

LONGEST = 1 << 16  # bytes of a payload
FRONT = struct.Struct("<IB")
CHECK = struct.Struct("<I")

_FRAME = struct.Struct("<ddqBB")
_COMMAND = struct.Struct("<qddd")
_STATUS = struct.Struct("<ddBH")


class Kind(IntEnum):
    """What a record is about; the first of a journal is its header, the last of a finished one its end."""

    HEADER = 1
    FRAME = 2
    COMMAND = 3
    STATUS = 4
    END = 5


@dataclass(frozen=True)
class TimedCommand:
    """A command, and ``robot_time``: when it was sent on the robot's clock (s; nan before the robot told its own)."""

    command: Command
    robot_time: float


Event: TypeAlias = Measurement | TimedCommand | RobotStatus


def seal(kind: Kind, payload: bytes) -> bytes:
    """Return a whole record. Raises `InvalidData` if the payload is too long."""
    if len(payload) > LONGEST:
        raise InvalidData(f"journal: expected a record of at most {LONGEST} bytes, got {len(payload)}")
    record = FRONT.pack(len(payload), kind) + payload
    return record + CHECK.pack(zlib.crc32(record))


def pack_header(header: Mapping[str, Any]) -> bytes:
    """Return the payload of a header."""
    return json.dumps(header, allow_nan=False).encode()


def pack_frame(frame: Measurement) -> bytes:
    """Return the payload of a frame."""
    body = _text(frame.body, 255)
    front = _FRAME.pack(frame.source_time, frame.arrival_time, frame.frame, frame.valid, len(body))
    return front + body + _numbers(frame.pose)


def pack_command(timed: TimedCommand) -> bytes:
    """Return the payload of a command."""
    command = timed.command
    return _COMMAND.pack(command.tick, command.due, command.time, timed.robot_time) + _numbers(command.control)


def pack_status(status: RobotStatus) -> bytes:
    """Return the payload of a status."""
    state, counters = _text(status.state, 255), json.dumps(dict(status.counters)).encode()
    front = _STATUS.pack(status.time, status.robot_time, len(state), len(counters))
    return front + state + counters + _numbers(status.control)


def unpack_header(payload: bytes) -> dict[str, Any]:
    """Return what `pack_header` packed. Raises `InvalidData`."""
    try:
        header = json.loads(payload)
    except (ValueError, RecursionError) as error:
        raise InvalidData("journal: the header is not JSON") from error
    if not isinstance(header, dict):
        raise InvalidData(f"journal: expected the header to be an object, got {type(header).__name__}")
    return header


def unpack(kind: Kind, payload: bytes, system: System) -> Event:
    """Return the event of a record. Raises `InvalidData` if it is not one of ``system``."""
    try:
        if kind is Kind.FRAME:
            source, arrival, number, valid, length = _FRAME.unpack_from(payload)
            body, pose = _split(payload, _FRAME.size, (length,), system.n_pose)
            return Measurement(source, arrival, number, body[0].decode(), bool(valid), pose)
        if kind is Kind.COMMAND:
            tick, due, time, robot_time = _COMMAND.unpack_from(payload)
            _, control = _split(payload, _COMMAND.size, (), system.nu)
            return TimedCommand(Command(tick, due, time, control), robot_time)
        time, robot_time, *lengths = _STATUS.unpack_from(payload)
        (state, text), control = _split(payload, _STATUS.size, tuple(lengths), system.nu)
        return RobotStatus(time, robot_time, state.decode(), control, _counters(text))
    except (struct.error, ValueError, RecursionError) as error:
        raise InvalidData(f"journal: a record of kind {kind.name.lower()} does not hold what it should") from error


def _counters(text: bytes) -> dict[str, int]:
    counters = json.loads(text)
    if not isinstance(counters, dict) or not all(type(value) is int for value in counters.values()):
        raise ValueError("counters")
    return counters


def _numbers(values: Array) -> bytes:
    return np.asarray(values, dtype="<f8").tobytes()


def _text(text: str, longest: int) -> bytes:
    """Return ``text`` in at most ``longest`` bytes of whole characters."""
    return text.encode(errors="replace")[:longest].decode(errors="ignore").encode()


def _split(payload: bytes, start: int, lengths: tuple[int, ...], count: int) -> tuple[list[bytes], Array]:
    """Return texts of these ``lengths`` from ``start`` on, and the ``count`` numbers that end the payload."""
    parts = []
    for length in lengths:
        parts.append(payload[start : start + length])
        start += length
    if len(payload) != start + 8 * count:
        raise ValueError("length")
    return parts, np.frombuffer(payload, "<f8", count, start).astype(np.float64)
