"""What happened on the robot's side, with times: the witness of every test of the fail-safes."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sysid_evo.errors import InvalidData


@dataclass(frozen=True)
class Entry:
    """``event`` at ``time`` (s, `time.monotonic`); ``value`` is the buttons, bytes in hexadecimal, or a mapping."""

    time: float
    event: str
    value: Any


class RigLogWriter:
    """Appends one JSON line for each event, unbuffered, so that nothing written is lost with the process.

    Events are "start", "buttons" (an int, bits as in a command), "in" and "out" (bytes that have
    passed the wire), "unplug", "plug", "reset", "fault" (the kind of one told later, at the time its
    first window opens) and "end".
    """

    def __init__(self, path: Path | None) -> None:
        self._file = -1 if path is None else os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)

    def note(self, time: float, event: str, value: int | str | Mapping[str, Any] | None = None) -> None:
        if self._file >= 0:
            os.write(self._file, json.dumps({"time": time, "event": event, "value": value}).encode() + b"\n")

    def close(self) -> None:
        if self._file >= 0:
            os.close(self._file)
            self._file = -1


class RigLogReader:
    """Follows a journal that is still being written; ``entries`` are all that have been read."""

    def __init__(self, path: str | Path) -> None:
        self._path = Path(path)
        self._offset = 0
        self.entries: list[Entry] = []

    def update(self) -> list[Entry]:
        """Read the lines that are new, of which the last may not have its end yet, and return all entries."""
        with self._path.open("rb") as file:
            file.seek(self._offset)
            whole, separator, _ = file.read().rpartition(b"\n")
        try:
            self.entries += [Entry(**json.loads(line)) for line in whole.splitlines()]
        except (TypeError, ValueError) as error:
            raise InvalidData(
                f"journal {self._path}: expected JSON lines of time, event and value, found another: {error}"
            ) from error
        self._offset += len(whole) + len(separator)
        return self.entries


def read_journal(path: str | Path) -> list[Entry]:
    """Return the entries of a journal."""
    return RigLogReader(path).update()


def buttons_at(entries: list[Entry], time: float) -> int:
    """Return the buttons that were closed at ``time``; 0 before the first entry."""
    buttons = 0
    for entry in entries:
        if entry.time > time:
            break
        if entry.event == "buttons":
            buttons = int(entry.value)
    return buttons


def opened_after(entries: list[Entry], time: float) -> float | None:
    """Return when the buttons opened for good: from then on they stay open to the journal's end.

    It is ``time`` itself if they were open already, None if they are closed at the end.
    """
    opened: float | None = time if buttons_at(entries, time) == 0 else None
    for entry in entries:
        if entry.event == "buttons" and entry.time > time:
            opened = entry.time if entry.value == 0 else None
    return opened
