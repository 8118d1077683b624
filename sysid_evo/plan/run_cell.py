"""One cell computed: claimed, computed of the results that it needs, and stored; also one that was sent by a process.

A cell travels in memory, pickled. Its result travels as files, see `Store.bundle`, or stays in the run folder.
"""

from __future__ import annotations

import io
import pickle
import time
import traceback
import warnings
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import cloudpickle  # type: ignore[import-untyped]  # it has no types

from sysid_evo.errors import ArtefactError, Blocked, InvalidArgument, LinkLost, SysidEvoError, described
from sysid_evo.plan.cell import Cell, CellContext
from sysid_evo.plan.store import Store, stored
from sysid_evo.processors import one_blas_thread


class Observer:
    """Is told what an execution is doing, and does nothing; the command line draws progress from it.

    Cells may run side by side.
    """

    def plan(self, cells: int, kept: int, seconds: float) -> None:
        """``cells`` in all, of which ``kept`` are done already; the others take about ``seconds``."""

    def start(self, cell: Cell) -> None:
        """``cell`` begins."""

    def progress(self, cell: Cell, done: int, total: int, note: str = "") -> None:
        """``cell`` has done so many of its steps; ``note`` is what else there is to say."""

    def finish(self, cell: Cell, *, cached: bool, reason: str | None) -> None:
        """``cell`` is done, was done before (``cached``), or failed for ``reason``."""

    def remark(self, sentence: str) -> None:
        """Something that the user should know, and that stops nothing."""


@dataclass(frozen=True)
class CellEnd:
    """How an attempt at a cell ended, and what is to be passed on to the user.

    ``status``: "done" now, or "kept" as it was stored already; "failed", and stored as such; "blocked" by what it
    needs; "busy" in another process; "unknown" to the worker that was asked. ``error`` is what was raised here.
    """

    status: Literal["done", "kept", "failed", "blocked", "busy", "unknown"]
    seconds: float = 0.0
    reason: str | None = None
    traceback: str = ""
    error: Exception | None = None
    remarks: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


class Unsendable(Exception):
    """A cell refers to something that cannot be pickled."""


class CellLost(Exception):
    """A cell has neither result nor failure: its worker died, or what came of it is not whole."""


def run_cell(
    store: Store, cell: Cell, failed: Collection[str] = (), observer: Observer | None = None, *, repair: bool = True
) -> CellEnd:
    """Compute ``cell`` and store its result, unless it is there or another process is at it.

    What it needs is in ``store``, but for the cells whose digests are in ``failed``. With ``repair`` a result among
    these that turns out to be unreadable is computed again. Raises OSError if the result cannot be written.
    """
    with store.claim(cell) as ours:
        if not ours:
            return CellEnd("busy")
        without = {needed.digest for needed in cell.needs} & set(failed)
        if store.done(cell) and store.without(cell) == without:
            return CellEnd("kept", store.seconds(cell))
        return _computed(store, cell, without, observer or Observer(), repair=repair)


def _computed(store: Store, cell: Cell, without: Collection[str], observer: Observer, *, repair: bool) -> CellEnd:
    observer.start(cell)
    checkpoint = store.checkpoint(cell)
    needs = {needed.digest for needed in cell.needs}

    def result(needed: Cell) -> Any:
        if needed.digest not in needs:
            raise InvalidArgument(f"{needed.title} is not among the needs of the cell that asks for its result")
        if needed.digest in without:
            return None
        try:
            return store.load(needed)
        except ArtefactError as error:
            if not repair:
                raise
            observer.remark(f"{error}: {needed.title} is computed again")
            end = _computed(store, needed, store.without(needed), observer, repair=True)
            observer.finish(needed, cached=False, reason=end.reason)
            if end.status != "done":
                raise ArtefactError(f"needs {needed.title}, which failed: {end.reason}") from error
            return store.load(needed)

    work = CellContext(result, partial(observer.progress, cell), store.new_path(cell), checkpoint, store.result_path)
    began = time.perf_counter()
    try:
        with one_blas_thread():  # so that sums are rounded alike everywhere
            value = cell.settings.compute(work)
    except Blocked as blocked:  # no failure of its own, so that none is stored
        return CellEnd("blocked", reason=str(blocked))
    except Exception as error:  # whatever a plugin does, the other cells go on
        return _failed(store, cell, error, time.perf_counter() - began)
    seconds = time.perf_counter() - began
    try:
        store.save(cell, value, seconds=seconds, without=without)
    except OSError:  # a full disk stops all cells
        raise
    except Exception as error:  # a plugin's result may be such that it cannot be written
        return _failed(store, cell, error, seconds)
    checkpoint.unlink(missing_ok=True)
    return CellEnd("done", seconds)


def _failed(store: Store, cell: Cell, error: Exception, seconds: float) -> CellEnd:
    reason = str(error) if isinstance(error, SysidEvoError) else described(error)
    trace = traceback.format_exc()
    store.fail(cell, reason=reason, traceback=trace, seconds=seconds)
    return CellEnd("failed", seconds, reason, trace, error)


class _Pickler(cloudpickle.Pickler):  # type: ignore[misc]  # it has no types
    """Also pickles what a notebook or a script defines. Recordings in a cell are replaced by their records."""

    def __init__(self, file: io.BytesIO, store: Store) -> None:
        super().__init__(file, protocol=pickle.HIGHEST_PROTOCOL)
        self._store = store

    def reducer_override(self, thing: Any) -> Any:
        if isinstance(thing, Cell) and thing.local and (record := self._store.find(thing.digest)) is not None:
            return stored, (record,)
        return super().reducer_override(thing)


def pickled(cell: Cell, store: Store) -> bytes:
    """Return ``cell`` and all that it refers to, for a worker. Raises `Unsendable`."""
    buffer = io.BytesIO()
    try:
        _Pickler(buffer, store).dump(cell)
    except Exception as error:  # whatever an object does that cannot be pickled
        raise Unsendable(f"{cell.title} cannot be sent: {type(error).__name__}: {error}") from error
    return buffer.getvalue()


OFTEN = 0.1  # s, between two reports of progress


class Telling(Observer):
    """Tells the process that sent a cell how far it is, by ``say(done, total, note)``; keeps remarks for later."""

    def __init__(self, say: Callable[[int, int, str], None]) -> None:
        self.remarks: list[str] = []
        self._say, self._next = say, 0.0

    def start(self, cell: Cell) -> None:
        self._say(0, 0, "")

    def progress(self, cell: Cell, done: int, total: int, note: str = "") -> None:
        now = time.monotonic()
        if now >= self._next:
            self._next = now + OFTEN
            self._say(done, total, note)

    def remark(self, sentence: str) -> None:
        self.remarks.append(sentence)


def run_sent(store: Store, sent: bytes, failed: Collection[str], say: Callable[[int, int, str], None]) -> CellEnd:
    """Compute a cell that another process has `pickled`, see `run_cell`; one that differs here is "unknown"."""
    observer = Telling(say)
    with warnings.catch_warnings(record=True) as caught:
        try:
            cell: Cell = pickle.loads(sent)  # memory of the process that this one works for, never a file
            why = "" if cell.digest_here() == cell.digest else "another version, or another plugin of that name"
        except Exception as error:  # whatever the code of another version raises
            why = f"{type(error).__name__}: {error}"
        if why:
            return CellEnd("unknown", reason=why)
        try:
            end = run_cell(store, cell, failed, observer)
        except SystemExit as error:  # of the cell, not of the worker
            end = _failed(store, cell, RuntimeError(f"it ends its process, with code {error.code}"), 0.0)
    told = tuple(str(warning.message) for warning in caught)
    lost = end.error if isinstance(end.error, LinkLost) else None  # it ends a command; others may not be picklable
    return replace(end, error=lost, remarks=(*observer.remarks, *store.remarks), warnings=told)
