"""A run folder as a store of results, which are found by the digest of all their inputs."""

from __future__ import annotations

import hashlib
import json
import os
import re
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, Literal, TypeAlias

from filelock import FileLock, Timeout
from pydantic import BaseModel, ConfigDict, ValidationError

from sysid_evo.errors import ArtefactError, SysidEvoError
from sysid_evo.files import write_atomically
from sysid_evo.plan.cell import Cell, CellContext, CellSettings
from sysid_evo.version import versions

CELLS, LOCKS, LOG = "cells", ".locks", "log.jsonl"
CHECKPOINT = ".checkpoint"
SCHEMA: Literal["sysid-evo/cell/1"] = "sysid-evo/cell/1"
MAX_BYTES = 2**22
NAME_LENGTH = 60
IN_MEMORY = 512
"""Maximum number of values in memory; the least recently used are dropped."""
WAITING = "not computed yet"


class CellRecord(BaseModel):
    """Content of ``cells/<digest>.json``: a computed or failed cell, and the place of its result.

    ``files`` maps each file of the result, relative to the run folder, to its SHA-256; ``artefact`` is their common
    path. ``without`` lists the failed needs of a tolerant cell.
    """

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    schema_: Literal["sysid-evo/cell/1"] = SCHEMA
    digest: str
    kind: str
    title: str
    name: str
    status: Literal["done", "failed"]
    reason: str | None = None
    traceback: str | None = None
    inputs: dict[str, Any]
    needs: list[str]
    without: list[str] = []
    artefact: str
    files: dict[str, str] = {}
    versions: dict[str, str]
    timings: dict[str, float]

    @property
    def seconds(self) -> float:
        """Duration of the computation in s."""
        return self.timings.get("seconds", 0.0)


@dataclass(frozen=True)
class CellOutcome:
    """Result of a cell: value, or None and the reason; seconds of computation; ``error`` of this execution, if any."""

    value: Any
    reason: str | None
    seconds: float
    error: Exception | None = None

    @property
    def failed(self) -> bool:
        return self.reason is not None


@dataclass
class Store:
    """The results in the run folder ``path``; several processes may use one folder at the same time.

    The values used last are kept in memory. ``remarks`` lists damaged files.
    """

    path: Path
    remarks: list[str]
    _values: dict[str, Any] = field(repr=False)

    def __init__(self, path: str | Path) -> None:
        self.path, self.remarks, self._values = Path(path), [], {}

    def records(self) -> list[CellRecord]:
        """Return all readable records, oldest first; each unreadable record adds a remark."""
        files = sorted((self.path / CELLS).glob("*.json"), key=lambda file: (file.stat().st_mtime_ns, file.name))
        found = (self._read(file) for file in files)
        return [record for record in found if record is not None]

    def find(self, digest: str) -> CellRecord | None:
        """Return the record of the cell with this digest; None if there is none or it is damaged."""
        file = self._record(digest)
        return self._read(file) if file.is_file() else None

    def done(self, cell: Cell) -> bool:
        """True if the result of ``cell`` is complete; a missing or damaged file adds a remark."""
        if cell.digest in self._values:
            return True
        record = self.find(cell.digest)
        if record is None or record.status != "done":
            return False
        for name, digest in record.files.items():
            if _digest(self.path / name) != digest:
                self._remark(f"{name} is missing or damaged: {cell.title} is computed again")
                return False
        return True

    def load(self, cell: Cell) -> Any:
        """Return the result of a cell that is done. Raises `ArtefactError`."""
        if cell.digest not in self._values:
            record = self.find(cell.digest)
            if record is None or record.status != "done":
                raise ArtefactError(f"{self.path}: {cell.title}: {WAITING}")
            try:
                self._remember(cell, cell.result.load(self.path / record.artefact))
            except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError, SysidEvoError) as error:
                raise ArtefactError(f"{self.path / record.artefact}: cannot be read: {error}") from error
        self._values[cell.digest] = self._values.pop(cell.digest)
        return cell.labelled(self._values[cell.digest])

    def _remember(self, cell: Cell, value: Any) -> None:
        self._values[cell.digest] = value
        if len(self._values) > IN_MEMORY:
            del self._values[next(iter(self._values))]

    def outcome(self, cell: Cell) -> CellOutcome:
        """Return the value of ``cell``, or the reason why there is none."""
        record = self.find(cell.digest)
        seconds = 0.0 if record is None else record.seconds
        if record is None and cell.digest not in self._values:
            return CellOutcome(None, self._why_not(cell), 0.0)
        if record is not None and record.status == "failed":
            return CellOutcome(None, record.reason, seconds)
        try:
            return CellOutcome(self.load(cell), None, seconds)
        except ArtefactError as error:
            return CellOutcome(None, str(error), seconds)

    def without(self, cell: Cell) -> set[str]:
        """Return the digests of the failed needs of a stored tolerant cell; its result may be outdated."""
        record = self.find(cell.digest) if cell.tolerant else None
        return set() if record is None else set(record.without)

    def seconds(self, cell: Cell) -> float:
        """Return the seconds of the last computation of ``cell``, 0 if unknown."""
        record = self.find(cell.digest)
        return 0.0 if record is None else record.seconds

    def last_computed(self, cells: Iterable[Cell]) -> datetime | None:
        """Return when the last of ``cells`` was computed, by the log; None if the log lists none of them."""
        wanted, last = {cell.digest for cell in cells}, None
        with suppress(OSError):
            for line in (self.path / LOG).read_bytes().splitlines():
                with suppress(ValueError, AttributeError):  # a line that another program wrote or cut off
                    event = json.loads(line)
                    last = max(last or 0.0, float(event["time"])) if event.get("digest") in wanted else last
        return None if last is None else datetime.fromtimestamp(last, UTC)

    def _why_not(self, cell: Cell) -> str:
        """Return why a cell has no record: a needed cell failed, or it is `WAITING`."""
        for needed in () if cell.tolerant else cell.needs:
            record = self.find(needed.digest)
            if record is not None and record.status == "failed":
                return blocked_reason(needed)
            if record is None and needed.digest not in self._values and self._why_not(needed) != WAITING:
                return blocked_reason(needed)
        return WAITING

    def new_path(self, cell: Cell) -> Path:
        """Return the path of the result of ``cell``, without suffix: a readable name and the start of the digest."""
        name = re.sub(r"[^\w.+-]+", "-", cell.name).strip("-.") or cell.kind
        return self.path / cell.result.folder / f"{name[:NAME_LENGTH]}-{cell.digest[:8]}"

    def checkpoint(self, cell: Cell) -> Path:
        """Return the path of the checkpoint of ``cell``."""
        return self.path / cell.result.folder / f"{cell.digest}{CHECKPOINT}"

    def result_path(self, cell: Cell) -> Path:
        """Return the path of the result of ``cell``; a stored result may have been saved under another name."""
        record = self.find(cell.digest)
        return self.new_path(cell) if record is None or record.status != "done" else self.path / record.artefact

    def save(self, cell: Cell, value: Any, *, seconds: float, without: Iterable[str] = ()) -> CellRecord:
        """Write the result of ``cell``, then its record; ``without`` holds the digests of failed needs."""
        files = cell.result.save(value, self.new_path(cell), cell)
        record = self._of(
            cell,
            status="done",
            seconds=seconds,
            files={file.relative_to(self.path).as_posix(): _digest(file) or "" for file in files},
            without=sorted(without),
        )
        self._write(record)
        self._remember(cell, value)
        return record

    def bundle(self, digest: str) -> Bundle:
        """Return the record and the result of a finished cell as files in memory. Raises `ArtefactError`."""
        record = self.find(digest)
        if record is None or record.status != "done":
            raise ArtefactError(f"{self.path}: the cell {digest}: {WAITING}")
        files = ((name, self.path / name) for name in (self._name(digest), *record.files))
        return tuple((name, file.stat().st_mtime_ns, file.read_bytes()) for name, file in files)

    def receive(self, cell: Cell, bundle: Bundle) -> CellRecord:
        """Store the result of ``cell`` that a worker computed: its record and its files.

        Raises `ArtefactError` if the bundle belongs to another cell or is incomplete, OSError if the disk is full.
        """
        (record_name, _, text), *files = bundle or ((self._name(cell.digest), 0, b""),)
        try:
            record = CellRecord.model_validate_json(text)
        except ValidationError as error:
            raise ArtefactError(f"{cell.title}: the received result has no readable record: {error}") from error
        digests = {name: hashlib.sha256(content).hexdigest() for name, _, content in files}
        folder, _, artefact = record.artefact.rpartition("/")
        fits = record_name == self._name(record.digest) and record.digest == cell.digest
        fits &= folder == cell.result.folder and artefact.endswith(f"-{cell.digest[:8]}")
        fits &= all(name.startswith(record.artefact) for name in digests)
        if not fits or record.status != "done" or record.files != digests:
            raise ArtefactError(f"{cell.title}: the received files are not the complete result of this cell")
        unpack(tuple(files), self.path)
        self._write(record)
        return record

    def fail(self, cell: Cell, *, reason: str, traceback: str, seconds: float) -> CellRecord:
        """Record the failure of ``cell``; the next execution tries it again."""
        record = self._of(cell, status="failed", seconds=seconds, reason=reason, traceback=traceback)
        self._write(record)
        return record

    def log(self, **event: Any) -> None:
        """Append one line to ``log.jsonl`` in one write, so that lines of two processes never mix."""
        self.path.mkdir(parents=True, exist_ok=True)
        line = json.dumps({"time": time.time(), **event}) + "\n"
        with (self.path / LOG).open("ab", buffering=0) as file:
            file.write(line.encode())

    @contextmanager
    def claim(self, cell: Cell) -> Iterator[bool]:
        """Claim ``cell`` for this process; yields False if another (living) process holds the claim."""
        folder = self.path / CELLS / LOCKS
        folder.mkdir(parents=True, exist_ok=True)
        lock = FileLock(folder / f"{cell.digest}.lock")
        try:
            lock.acquire(timeout=0)
        except Timeout:
            yield False
            return
        try:
            yield True
        finally:
            lock.release()

    def busy(self) -> bool:
        """True if a process holds a claim on a cell of this folder."""
        for file in (self.path / CELLS / LOCKS).glob("*.lock"):
            lock = FileLock(file)
            try:
                lock.acquire(timeout=0)
            except Timeout:
                return True
            lock.release()
        return False

    def _of(self, cell: Cell, *, status: Literal["done", "failed"], seconds: float, **fields: Any) -> CellRecord:
        return CellRecord(
            digest=cell.digest,
            kind=cell.kind,
            title=cell.title,
            name=cell.name,
            status=status,
            inputs=cell.settings.inputs(),
            needs=[needed.digest for needed in cell.needs],
            artefact=self.new_path(cell).relative_to(self.path).as_posix(),
            versions=versions(),
            timings={"seconds": seconds},
            **fields,
        )

    def _name(self, digest: str) -> str:
        return f"{CELLS}/{digest}.json"

    def _record(self, digest: str) -> Path:
        return self.path / self._name(digest)

    def _read(self, file: Path) -> CellRecord | None:
        try:
            if file.stat().st_size > MAX_BYTES:
                raise ValueError(f"a record has at most {MAX_BYTES} bytes")
            record = CellRecord.model_validate_json(file.read_bytes())
            if record.digest != file.stem:
                raise ValueError("it is the record of another cell")
            outside = [name for name in (*record.files, record.artefact) if not is_inside(name)]
            if outside:
                raise ValueError(f"{outside[0]} is outside the run folder")
        except FileNotFoundError:
            return None
        except (OSError, ValidationError, ValueError) as error:
            first = str(error).splitlines()[0]
            self._remark(f"{file} is damaged ({first}): its cell is computed again")
            return None
        return record

    def _write(self, record: CellRecord) -> None:
        text = record.model_dump_json(indent=1)
        write_atomically(self._record(record.digest), lambda file: file.write_text(text, encoding="utf-8"))
        self.log(**record.model_dump(include={"digest", "title", "status", "reason", "traceback", "timings"}))

    def _remark(self, sentence: str) -> None:
        if sentence not in self.remarks:
            self.remarks.append(sentence)


@dataclass(frozen=True)
class Stored(CellSettings):
    """Settings of a cell that is known by its ``record`` only: it can be loaded, not computed."""

    record: CellRecord

    def inputs(self) -> dict[str, Any]:
        return self.record.inputs

    def compute(self, work: CellContext) -> Any:
        raise ArtefactError(
            f"{self.record.artefact} is missing or damaged and cannot be computed here: rerun the command that made it"
        )


def stored(record: CellRecord) -> Cell[Stored]:
    """Return the cell of ``record``, which can be loaded but not computed."""
    return Cell(
        kind=record.kind,
        name=record.name,
        title=record.title,
        settings=Stored(record),
        known_digest=record.digest,
    )


def blocked_reason(needed: Cell) -> str:
    """Return the reason of a cell that is not computed because ``needed`` failed."""
    return f"needs {needed.title}, which failed"


def _digest(file: Path) -> str | None:
    try:
        with file.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError:
        return None


Bundle: TypeAlias = tuple[tuple[str, int, bytes], ...]
"""Files below a folder: path, time of the last change in ns, content; oldest first."""


def unpack(bundle: Bundle, folder: Path) -> list[Path]:
    """Write the files of ``bundle`` below ``folder`` and return them. Raises `ArtefactError` for a path outside it."""
    written = []
    for name, changed, content in bundle:
        if not (folder / name).parent.resolve().is_relative_to(folder.resolve()):
            raise ArtefactError(f"{name} is outside the target folder")
        file = write_atomically(folder / name, partial(Path.write_bytes, data=content))
        os.utime(file, ns=(changed, changed))
        written.append(file)
    return written


def is_inside(name: str) -> bool:
    """True if ``name`` is a relative path that stays below its folder."""
    path = Path(name)
    return not path.is_absolute() and ".." not in path.parts
