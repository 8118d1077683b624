"""The journal of a session: every frame, command and status, readable up to the moment of a crash.

An append-only file of checked records (`records`). Each is handed to the system by one write as it
happens, so a process that is killed loses at most the record it was writing.
"""

from __future__ import annotations

import contextlib
import os
import zlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hardware.listener import RobotStatus
from hardware.measurement import Measurement
from hardware.recording.records import (
    CHECK,
    FRONT,
    LONGEST,
    Event,
    Kind,
    TimedCommand,
    pack_header,
    seal,
    unpack,
    unpack_header,
)
from hardware.session import Session
from hardware.trackers.gates import GateLimits
from sysid_evo.errors import InvalidArgument, InvalidData, SysidEvoError
from sysid_evo.system import System

SUFFIX = ".rcj"
MAGIC = b"RCJ\r\n\x1a\n\x00"
SCHEMA = "sysid-evo/journal/1"
TAKEN = "{}: a recording is there already; choose another folder or name"


def check_journals(folder: Path, names: Iterable[str]) -> None:
    """Raise `InvalidArgument` unless journals of these ``names`` can be begun in ``folder``; makes nothing."""
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


class JournalWriter(Session):
    """Appends records to a new file; nothing is kept back in this process."""

    def __init__(self, path: Path, header: Mapping[str, Any]) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND | os.O_CLOEXEC, 0o644)
        except FileExistsError:
            raise InvalidArgument(TAKEN.format(path)) from None
        self._size = 0
        self._folder = path.parent
        self.append(MAGIC + seal(Kind.HEADER, pack_header({"schema": SCHEMA, **header})))

    def append(self, record: bytes) -> None:
        """Write a sealed record, all of it or nothing. Raises `OSError`."""
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
            os.write(file, seal(Kind.END, b""))
            os.fsync(file)
        finally:
            os.close(file)
        with contextlib.suppress(OSError):  # folders cannot be synced everywhere
            folder = os.open(self._folder, os.O_RDONLY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)


@dataclass(frozen=True)
class Journal:
    """What a journal holds: ``events`` in the order in which they were told, ``limits`` of the gate they met.

    ``closed`` says whether the recorder came to its end, ``torn`` how many bytes of an unfinished
    record were left out.
    """

    name: str
    header: Mapping[str, Any]
    system: System
    limits: GateLimits
    events: tuple[Event, ...]
    closed: bool
    torn: int = 0

    @property
    def frames(self) -> tuple[Measurement, ...]:
        """Frames of the tracker, believed or not."""
        return tuple(event for event in self.events if isinstance(event, Measurement))

    @property
    def commands(self) -> tuple[TimedCommand, ...]:
        """Commands with the times of both clocks."""
        return tuple(event for event in self.events if isinstance(event, TimedCommand))

    @property
    def statuses(self) -> tuple[RobotStatus, ...]:
        """What the robot said of itself."""
        return tuple(event for event in self.events if isinstance(event, RobotStatus))

    @property
    def notes(self) -> tuple[str, ...]:
        """What is not as it should be, in sentences."""
        notes = [] if self.closed else [f"{self.name}: the journal has no end, so its recorder was stopped by force"]
        if self.torn:
            notes.append(f"{self.name}: {self.torn} bytes of an unfinished record at the end left out")
        return tuple(notes)


def read_journal(path: str | Path) -> Journal:
    """Read a journal, finished or not.

    An unfinished record at the end is left out (`Journal.torn`). Raises `InvalidData` on anything
    else that is not as `JournalWriter` writes it.
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
        if (system is None) != (kind is Kind.HEADER):
            raise InvalidData(f"{path.name}, byte {end}: expected one header, and first")
        if system is None:
            header = unpack_header(payload)
            system = _system(header, path.name)
        elif kind is Kind.END:
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


def _records(data: bytes, name: str) -> Iterator[tuple[Kind, bytes, int]]:
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
            yield Kind(kind), data[place + FRONT.size : check], after
        except ValueError:
            raise InvalidData(f"{name}, byte {place}: no kind of record has the number {kind}") from None
        place = after


def _system(header: Mapping[str, Any], name: str) -> System:
    if header.get("schema") != SCHEMA:
        raise InvalidData(f"{name}: expected a journal of schema {SCHEMA!r}, got {str(header.get('schema'))[:40]!r}")
    try:
        return System.from_dict(header["system"])
    except (KeyError, TypeError, ValueError, AttributeError, SysidEvoError) as error:
        raise InvalidData(f"{name}: the header does not describe a system: {type(error).__name__}") from error


def _limits(header: Mapping[str, Any], name: str) -> GateLimits:
    try:
        return GateLimits.from_dict(header["limits"])
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InvalidData(f"{name}: the header does not say what the gate's limits are: {error}") from error
