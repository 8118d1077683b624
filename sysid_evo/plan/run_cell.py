"""Computation of one cell: claim it, compute it from the results that it needs, store its result.

Cells are sent to workers as pickles in memory. Results are sent as files, see `Store.bundle`, or stay in the run
folder.
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
from sysid_evo.plan.cell import Cell, CellContext, Observer
from sysid_evo.plan.store import Store, stored
from sysid_evo.processors import one_blas_thread
from sysid_evo.registry.objects import objects_named, receive_objects


@dataclass(frozen=True)
class CellEnd:
    """Result of one attempt to compute a cell, with remarks and warnings for the user.

    ``status`` is "done"; "kept" (stored before); "failed" (and stored as such); "blocked" by a failed need; "busy" in
    another process; or "unknown" to the worker. ``error`` is the exception raised in this process.
    """

    status: Literal["done", "kept", "failed", "blocked", "busy", "unknown"]
    seconds: float = 0.0
    reason: str | None = None
    traceback: str = ""
    error: Exception | None = None
    remarks: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


class Unsendable(Exception):
    """A cell refers to an object that cannot be pickled."""


class CellLost(Exception):
    """A cell has neither a result nor a failure: its worker died, or the result is incomplete."""


def run_cell(
    store: Store, cell: Cell, failed: Collection[str] = (), observer: Observer | None = None, *, repair: bool = True
) -> CellEnd:
    """Compute ``cell`` and store its result, unless it is stored or another process computes it.

    Its needs must be in ``store``, except those whose digests are in ``failed``. With ``repair``, an unreadable result
    of a needed cell is computed again. Raises OSError if the result cannot be written.
    """
    with store.claim(cell) as claimed:
        if not claimed:
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
            raise InvalidArgument(f"{needed.title} is not among the needs of {cell.title}: add it to needs")
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
        with one_blas_thread():  # so that sums are rounded the same everywhere
            value = cell.settings.compute(work)
    except Blocked as blocked:  # not a failure of this cell, so none is stored
        return CellEnd("blocked", reason=str(blocked))
    except Exception as error:  # an error of a plugin must not stop the other cells
        return _failed(store, cell, error, time.perf_counter() - began)
    seconds = time.perf_counter() - began
    try:
        store.save(cell, value, seconds=seconds, without=without)
    except OSError:  # a full disk stops all cells
        raise
    except Exception as error:  # the result of a plugin may not be writable
        return _failed(store, cell, error, seconds)
    checkpoint.unlink(missing_ok=True)
    return CellEnd("done", seconds)


def _failed(store: Store, cell: Cell, error: Exception, seconds: float) -> CellEnd:
    reason = str(error) if isinstance(error, SysidEvoError) else described(error)
    trace = traceback.format_exc()
    store.fail(cell, reason=reason, traceback=trace, seconds=seconds)
    return CellEnd("failed", seconds, reason, trace, error)


class _Pickler(cloudpickle.Pickler):  # type: ignore[misc]  # it has no types
    """Pickler that accepts definitions of a notebook or script, and replaces recordings in a cell by their records."""

    def __init__(self, file: io.BytesIO, store: Store) -> None:
        super().__init__(file, protocol=pickle.HIGHEST_PROTOCOL)
        self._store = store

    def reducer_override(self, thing: Any) -> Any:
        if isinstance(thing, Cell) and thing.local and (record := self._store.find(thing.digest)) is not None:
            return stored, (record,)
        return super().reducer_override(thing)


def pickled(cell: Cell, store: Store) -> bytes:
    """Return ``cell`` and all objects that it refers to or names, pickled for a worker. Raises `Unsendable`."""
    buffer = io.BytesIO()
    try:
        _Pickler(buffer, store).dump(cell)
        return cloudpickle.dumps((objects_named(buffer.getvalue()), buffer.getvalue()))
    except Exception as error:  # an object that cannot be pickled may raise anything
        raise Unsendable(f"{cell.title} cannot be sent: {type(error).__name__}: {error}") from error


PROGRESS_INTERVAL = 0.1  # s


class ForwardingObserver(Observer):
    """Observer that sends progress to the parent process by ``report(done, total, note)`` and collects remarks."""

    def __init__(self, report: Callable[[int, int, str], None]) -> None:
        self.remarks: list[str] = []
        self._report, self._next = report, 0.0

    def start(self, cell: Cell) -> None:
        self._report(0, 0, "")

    def progress(self, cell: Cell, done: int, total: int, note: str = "") -> None:
        now = time.monotonic()
        if now >= self._next:
            self._next = now + PROGRESS_INTERVAL
            self._report(done, total, note)

    def remark(self, sentence: str) -> None:
        self.remarks.append(sentence)


def run_sent(store: Store, sent: bytes, failed: Collection[str], report: Callable[[int, int, str], None]) -> CellEnd:
    """Compute a cell that another process has `pickled`, see `run_cell`; "unknown" if its digest differs here."""
    observer = ForwardingObserver(report)
    with warnings.catch_warnings(record=True) as caught:
        try:
            objects, content = pickle.loads(sent)  # from the memory of the parent process, never from a file
            receive_objects(objects)
            cell: Cell = pickle.loads(content)
            why = "" if cell.digest_here() == cell.digest else "another version, or another plugin of that name"
        except Exception as error:  # code of another version may raise anything
            why = f"{type(error).__name__}: {error}"
        if why:
            return CellEnd("unknown", reason=why)
        try:
            end = run_cell(store, cell, failed, observer)
        except SystemExit as error:  # of the cell, not of the worker
            end = _failed(store, cell, RuntimeError(f"it called exit with code {error.code}"), 0.0)
    sentences = tuple(str(warning.message) for warning in caught)
    lost = end.error if isinstance(end.error, LinkLost) else None  # it ends a command; others may not be picklable
    return replace(end, error=lost, remarks=(*observer.remarks, *store.remarks), warnings=sentences)
