"""The journal of a session: record format, writer, recorder (a listener), and reader.

It is readable up to a crash: an append-only file of records with checksums. Each is passed to the system by one write
as it happens, so a process that is killed loses at most the record that it was writing.

A record is its length (u32, of the payload), its kind (u8), the payload and a CRC-32 of all before it;
little-endian throughout. Text in a payload is UTF-8 after its length.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import platform
import struct
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from enum import IntEnum
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from hardware.connection import Closeable, Command, Connectable, GateLimits, Listener, Measurement, RobotStatus
from sysid_evo.errors import InvalidArgument, InvalidData, SysidEvoError
from sysid_evo.system import System
from sysid_evo.types import Array

SUFFIX = ".rcj"
MAGIC = b"RCJ\r\n\x1a\n\x00"
SCHEMA = "sysid-evo/journal/1"

LONGEST = 1 << 16  # bytes of a payload
FRONT = struct.Struct("<IB")
CHECK = struct.Struct("<I")

_FRAME = struct.Struct("<ddqBB")
_COMMAND = struct.Struct("<qddd")
_STATUS = struct.Struct("<ddBH")


class RecordKind(IntEnum):
    """Kind of a record; the first of a journal is its header, the last of a finished one its end."""

    HEADER = 1
    FRAME = 2
    COMMAND = 3
    STATUS = 4
    END = 5


@dataclass(frozen=True)
class TimedCommand:
    """A command, and ``robot_time``: when it was sent on the robot's clock (s; NaN before its first status)."""

    command: Command
    robot_time: float


Event: TypeAlias = Measurement | TimedCommand | RobotStatus


def seal(kind: RecordKind, payload: bytes) -> bytes:
    """Return a whole record. Raises `InvalidData` if the payload is too long."""
    if len(payload) > LONGEST:
        raise InvalidData(f"journal: expected a record of at most {LONGEST} bytes, got {len(payload)}")
    record = FRONT.pack(len(payload), kind) + payload
    return record + CHECK.pack(zlib.crc32(record))


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


def unpack(kind: RecordKind, payload: bytes, system: System) -> Event:
    """Return the event of a record. Raises `InvalidData` if it is not one of ``system``."""
    try:
        if kind is RecordKind.FRAME:
            source, arrival, number, valid, length = _FRAME.unpack_from(payload)
            body, pose = _split(payload, _FRAME.size, (length,), system.n_pose)
            return Measurement(source, arrival, number, body[0].decode(), bool(valid), pose)
        if kind is RecordKind.COMMAND:
            tick, due, time, robot_time = _COMMAND.unpack_from(payload)
            _, control = _split(payload, _COMMAND.size, (), system.nu)
            return TimedCommand(Command(tick, due, time, control), robot_time)
        time, robot_time, *lengths = _STATUS.unpack_from(payload)
        (state, text), control = _split(payload, _STATUS.size, tuple(lengths), system.nu)
        counters = json.loads(text)
        if not isinstance(counters, dict) or not all(type(value) is int for value in counters.values()):
            raise ValueError("counters")
        return RobotStatus(time, robot_time, state.decode(), control, counters)
    except (struct.error, ValueError, RecursionError) as error:
        raise InvalidData(f"journal: invalid content of a record of kind {kind.name.lower()}") from error


def _numbers(values: Array) -> bytes:
    return np.asarray(values, dtype="<f8").tobytes()


def _text(text: str, longest: int) -> bytes:
    """Return ``text`` in at most ``longest`` bytes of whole characters."""
    return text.encode(errors="replace")[:longest].decode(errors="ignore").encode()


def _split(payload: bytes, start: int, lengths: tuple[int, ...], count: int) -> tuple[list[bytes], Array]:
    """Return texts of these ``lengths`` from ``start``, and the ``count`` numbers at the end of the payload."""
    parts = []
    for length in lengths:
        parts.append(payload[start : start + length])
        start += length
    if len(payload) != start + 8 * count:
        raise ValueError("length")
    return parts, np.frombuffer(payload, "<f8", count, start).astype(np.float64)


TAKEN = "{}: a recording exists already; choose another folder or name"


def check_journals(folder: Path, names: Iterable[str]) -> None:
    """Raise `InvalidArgument` unless journals of these ``names`` can be created in ``folder``; creates nothing."""
    for name in names:
        path = folder / f"{name}{SUFFIX}"
        if path.exists():
            raise InvalidArgument(TAKEN.format(path))
    place = folder.absolute()
    while not place.exists():
        place = place.parent
    if not place.is_dir():
        raise InvalidArgument(f"{folder}: expected a folder for journals, but {place} is a file")
    if not os.access(place, os.W_OK | os.X_OK):
        raise InvalidArgument(f"{folder}: expected a folder that can be written, but {place} does not permit it")


class JournalWriter(Closeable):
    """Appends records to a new file, without buffering in this process."""

    def __init__(self, path: Path, header: Mapping[str, Any]) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND | os.O_CLOEXEC, 0o644)
        except FileExistsError:
            raise InvalidArgument(TAKEN.format(path)) from None
        self._size = 0
        self._folder = path.parent
        described = json.dumps({"schema": SCHEMA, **header}, allow_nan=False).encode()
        self.append(MAGIC + seal(RecordKind.HEADER, described))

    def append(self, record: bytes) -> None:
        """Write a sealed record completely or not at all. Raises `OSError`."""
        written = os.write(self._file, record)
        if written != len(record):
            os.ftruncate(self._file, self._size)
            raise OSError(f"only {written} of {len(record)} bytes could be written: is the disk full?")
        self._size += written

    def close(self) -> None:
        """Write the end, and wait until file and folder are on the disk; a second call does nothing."""
        if self._file < 0:
            return
        file, self._file = self._file, -1
        try:
            os.write(file, seal(RecordKind.END, b""))
            os.fsync(file)
        finally:
            os.close(file)
        with contextlib.suppress(OSError):  # folders cannot be synced everywhere
            folder = os.open(self._folder, os.O_RDONLY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)


VERSIONS = {name: version(name) for name in ("sysid-evo", "numpy")} | {"python": platform.python_version()}


class Recorder(Closeable, Listener):
    """Writes every frame, command and status of a session with ``robot`` to a new journal at ``path``.

    ``limits`` are stored, so that readers accept the same frames.
    Each call is one write to the system's cache, some ten microseconds. A disk that cannot take a
    record does not stop a robot: the record is counted in ``lost``, and ``problem`` gives the reason.
    `close` waits for the disk.
    """

    def __init__(self, path: str | Path, system: System, *, robot: str, limits: GateLimits | None = None) -> None:
        self.path = Path(path)
        self.lost = 0
        self.problem: str | None = None
        self._status: RobotStatus | None = None
        self._journal = JournalWriter(
            self.path,
            {
                "system": system.to_dict(),
                "robot": robot,
                "limits": (GateLimits() if limits is None else limits).to_dict(),
                "versions": VERSIONS,
            },
        )

    def on_measurement(self, measurement: Measurement) -> None:
        self._write(RecordKind.FRAME, pack_frame, measurement)

    def on_command(self, command: Command) -> None:
        status = self._status
        robot_time = math.nan if status is None else status.robot_time + command.time - status.time
        self._write(RecordKind.COMMAND, pack_command, TimedCommand(command, robot_time))

    def on_status(self, status: RobotStatus) -> None:
        self._status = status
        self._write(RecordKind.STATUS, pack_status, status)

    def close(self) -> None:
        try:
            self._journal.close()
        except OSError as error:
            self.problem = f"{self.path}: {error}"

    def _write(self, kind: RecordKind, pack: Callable[[Any], bytes], event: object) -> None:
        try:
            self._journal.append(seal(kind, pack(event)))
        except (OSError, struct.error, InvalidData) as error:
            self.lost += 1
            self.problem = f"{self.path}: {error}"


JOURNALS = "journal"


def recorder_of(folder: Path, robot: Connectable, name: str, limits: GateLimits | None = None) -> Recorder:
    """Return the recorder of the trial ``name``; ``limits`` are those of the gate that its frames pass."""
    return Recorder(folder / JOURNALS / f"{name}{SUFFIX}", robot.system, robot=robot.name, limits=limits)


@dataclass(frozen=True)
class Journal:
    """Content of a journal: ``events`` in the order of their arrival, ``limits`` of the gate during the run.

    ``closed`` is true if the recorder was closed; ``torn`` is the number of bytes of an unfinished record that were
    left out.
    """

    name: str
    header: Mapping[str, Any]
    system: System
    limits: GateLimits
    events: tuple[Event, ...]
    closed: bool
    torn: int = 0

    @property
    def commands(self) -> tuple[TimedCommand, ...]:
        """Commands with the times of both clocks."""
        return tuple(event for event in self.events if isinstance(event, TimedCommand))


def read_journal(path: str | Path) -> Journal:
    """Read a journal, finished or not.

    An unfinished record at the end is left out (`Journal.torn`). Raises `InvalidData` for any other deviation from the
    format of `JournalWriter`.
    """
    path = Path(path)
    data = path.read_bytes()
    if not data.startswith(MAGIC):
        raise InvalidData(f"{path.name}: expected a journal, which begins with {MAGIC!r}, got {data[: len(MAGIC)]!r}")
    system: System | None = None
    header: dict[str, Any] = {}
    events: list[Event] = []
    closed, end = False, len(MAGIC)
    for kind, payload, after in _records(data, path.name):
        if closed:
            raise InvalidData(f"{path.name}, byte {end}: a record after the end of the journal")
        if (system is None) != (kind is RecordKind.HEADER):
            raise InvalidData(f"{path.name}, byte {end}: expected one header, as the first record")
        if system is None:
            header, system = _described(payload, path.name)
        elif kind is RecordKind.END:
            closed = True
        else:
            try:
                events.append(unpack(kind, payload, system))
            except InvalidData as error:
                raise InvalidData(f"{path.name}, byte {end}: {error}") from error
        end = after
    if system is None:
        raise InvalidData(f"{path.name}: the journal ends in its header; nothing was recorded")
    return Journal(path.stem, header, system, _limits(header, path.name), tuple(events), closed, len(data) - end)


def _records(data: bytes, name: str) -> Iterator[tuple[RecordKind, bytes, int]]:
    """Yield kind, payload and end of each whole record, up to an unfinished one at the end of ``data``."""
    place = len(MAGIC)
    while place < len(data):
        if len(data) - place < FRONT.size:
            return
        length, kind = FRONT.unpack_from(data, place)
        if length > LONGEST:
            raise InvalidData(f"{name}, byte {place}: expected a record of at most {LONGEST} bytes, got {length}")
        check = place + FRONT.size + length
        after = check + CHECK.size
        if after > len(data):
            return
        if zlib.crc32(data[place:check]) != CHECK.unpack_from(data, check)[0]:
            if after == len(data) or not any(data[place:]):
                return  # the last write of a machine that lost power
            raise InvalidData(f"{name}, byte {place}: the record is damaged (its checksum is wrong)")
        try:
            yield RecordKind(kind), data[place + FRONT.size : check], after
        except ValueError:
            raise InvalidData(f"{name}, byte {place}: no kind of record has the number {kind}") from None
        place = after


def _described(payload: bytes, name: str) -> tuple[dict[str, Any], System]:
    """Return the header, and the system that it describes. Raises `InvalidData`."""
    try:
        header = json.loads(payload)
    except (ValueError, RecursionError) as error:
        raise InvalidData("journal: the header is not JSON") from error
    if not isinstance(header, dict):
        raise InvalidData(f"journal: expected the header to be an object, got {type(header).__name__}")
    if header.get("schema") != SCHEMA:
        raise InvalidData(f"{name}: expected a journal of schema {SCHEMA!r}, got {str(header.get('schema'))[:40]!r}")
    try:
        return header, System.from_dict(header["system"])
    except (KeyError, TypeError, ValueError, AttributeError, SysidEvoError) as error:
        raise InvalidData(f"{name}: the header does not describe a system: {type(error).__name__}") from error


def _limits(header: Mapping[str, Any], name: str) -> GateLimits:
    try:
        return GateLimits.from_dict(header["limits"])
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InvalidData(f"{name}: the header has no valid limits of the gate: {error}") from error
