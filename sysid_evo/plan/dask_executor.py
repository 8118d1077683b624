"""Execution of the cells of a plan on the workers of a Dask cluster, which need no access to the run folder.

Cells are sent as pickles, results as the bytes of their files. Only this process writes the run folder, as results
arrive, so finished results survive a failure of the cluster. The lower half of this module runs in the workers.
"""

from __future__ import annotations

import ctypes
import hashlib
import json
import logging
import os
import shutil
import tempfile
import threading
import time
import uuid
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import CancelledError, Future
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from queue import Empty, SimpleQueue
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, TypeAlias, Union

from sysid_evo.errors import ArtefactError, InvalidArgument, PluginError, SchedulerLost
from sysid_evo.plan.cell import Cell
from sysid_evo.plan.run_cell import CellEnd, CellLost, pickled, run_sent
from sysid_evo.plan.store import Bundle, Store, unpack
from sysid_evo.processors import ENGINE_VARIABLE, resolve, use_processors
from sysid_evo.registry.plugins import load_plugins_again, loaded_plugins
from sysid_evo.version import versions

if TYPE_CHECKING:
    import distributed
    from distributed import Client

POLL_INTERVAL = 1.0  # s, between two checks of the workers
ALONE = 5.0  # s without workers, after which a remark is made
PATIENCE = 5.0  # s, time limit for sending data to a worker
MAX_LOST_ATTEMPTS = 20
"""Number of attempts at a cell whose data are lost in the cluster."""
AHEAD = 2
"""Cells sent per thread of the workers, so that no thread waits for this process."""
FIRST = 16
"""Cells sent while there are no workers, for a cluster that grows with its work."""
RUNNING = "running"


@dataclass(frozen=True)
class RemoteTask:
    """A pickled cell of ``run``, its failed needs, and the engine, plugins and versions that a worker must have."""

    run: str
    digest: str
    cell: bytes
    failed: tuple[str, ...]
    engine: str
    plugins: Bundle
    versions: dict[str, str]


@dataclass
class SentCell:
    """A cell that was sent, with this process's claim on it and the workers it is restricted to, if any."""

    cell: Cell
    claim: ExitStack
    only: frozenset[str] | None = None


class DaskExecutor:
    """The workers of ``scheduler`` for the ``cells`` of a plan; ``remark`` passes a sentence to the user.

    A result that cells need is sent once and stays in the cluster as long as an unfinished cell needs it.
    """

    def __init__(
        self, store: Store, cells: Sequence[Cell], scheduler: Scheduler, remark: Callable[[str], None]
    ) -> None:
        self._store, self._scheduler, self._remark = store, scheduler, remark
        self._sent_cells: dict[Future[Any], SentCell] = {}
        self._users = Counter(digest for cell in cells for digest in {needed.digest for needed in cell.needs})
        self._sent: dict[str, distributed.Future[Any]] = {}
        self._unable: dict[str, set[str]] = {}  # workers that cannot run a cell
        self._lost: Counter[str] = Counter()
        self._events: SimpleQueue[tuple[str, int, int, str]] = SimpleQueue()
        self._threads: dict[str, int] = {}
        self._last_look, self._last_worker = 0.0, time.monotonic()
        self._run = uuid.uuid4().hex
        files = map(Path, loaded_plugins())
        self._plugins: Bundle = tuple((file.name, 0, file.read_bytes()) for file in files if file.is_file())

    def __enter__(self) -> Self:
        self._open = ExitStack()
        self._client = self._open.enter_context(connected(self._scheduler))
        self._address = getattr(self._client.scheduler, "address", "its address")
        self._executor = self._client.get_executor(pure=False)
        self._listen()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._open:
            for sent_cell in self._sent_cells.values():
                sent_cell.claim.close()
            if self._client.status == RUNNING:
                with self._unless_lost():
                    self._executor.shutdown(wait=False)
                    self._client.unsubscribe_topic(self._run)
            self._sent.clear()

    def n_idle(self) -> int:
        """Return the number of cells to send now. Raises `SchedulerLost`."""
        self._look()
        if self._client.status != RUNNING:
            return 0
        return (AHEAD * sum(self._threads.values()) or FIRST) - len(self._sent_cells)

    def submit(self, cell: Cell, failed: Collection[str]) -> Future[Any] | None:
        """Send ``cell``; None if another process computes it, or no worker is connected. Raises `Unsendable`."""
        future: Future[Any] | None = None
        with ExitStack() as claim:
            if not claim.enter_context(self._store.claim(cell)):
                return None
            if self._store.done(cell) and self._store.without(cell) == set(failed):
                future = Future()
                future.set_result((CellEnd("kept", self._store.seconds(cell)), (), ""))
                self._sent_cells[future] = SentCell(cell, claim.pop_all())
                return future
            task = RemoteTask(
                self._run, cell.digest, pickled(cell, self._store), tuple(failed), resolve(), self._plugins, versions()
            )
            unable = self._unable.get(cell.digest, set())
            only = frozenset(self._threads) - unable if unable else None
            with self._unless_lost():
                needed = self._bundles({needed.digest for needed in cell.needs} - set(failed))
                where = {} if only is None else {"workers": sorted(only)}
                future = self._executor.submit(compute, task, needed, **where)
                self._sent_cells[future] = SentCell(cell, claim.pop_all(), only)
        return future

    def result(self, cell: Cell, future: Future[Any]) -> CellEnd:
        """Store the result of ``cell`` and return its end. Raises `CellLost`, OSError if the disk is full."""
        from distributed import KilledWorker

        with self._sent_cells.pop(future).claim:
            try:
                end, bundle, worker = future.result()
            except CancelledError:
                return self._retry(cell)
            except KilledWorker as error:
                times = error.allowed_failures + 1
                return self._failed(cell, f"{times} worker{'s' if times > 1 else ''} died while computing it")
            except Exception as error:  # a worker with another version may raise anything
                return CellEnd("unknown", reason=f"{type(error).__name__}: {error}")
            if end.status == "unknown":
                return self._unknown(cell, end, worker)
            if end.status == "done":
                try:
                    self._store.receive(cell, bundle)
                except ArtefactError as error:
                    raise CellLost(str(error)) from error
                self._store.checkpoint(cell).unlink(missing_ok=True)
            elif end.status == "failed":
                self._store.fail(cell, reason=end.reason or "", traceback=end.traceback, seconds=end.seconds)
        for digest in {needed.digest for needed in cell.needs}:
            self._users[digest] -= 1
            if not self._users[digest]:
                self._sent.pop(digest, None)
        return end

    def progress(self) -> Iterator[tuple[Cell, int, int, str]]:
        """Yield the progress events of the workers since the last call."""
        cells = {sent_cell.cell.digest: sent_cell.cell for sent_cell in self._sent_cells.values()}
        with suppress(Empty):
            while True:
                digest, done, total, note = self._events.get_nowait()
                if digest in cells:
                    yield cells[digest], done, total, note

    def _failed(self, cell: Cell, reason: str) -> CellEnd:
        self._store.fail(cell, reason=reason, traceback="", seconds=0.0)
        return CellEnd("failed", reason=reason)

    def _retry(self, cell: Cell) -> CellEnd:
        """Send a cell again that was lost in the cluster, with its needs."""
        self._last_look = 0.0  # check the scheduler at the next call
        self._lost[cell.digest] += 1
        if self._lost[cell.digest] > MAX_LOST_ATTEMPTS:
            return self._failed(cell, f"the cell or its inputs were lost in the cluster {MAX_LOST_ATTEMPTS} times")
        for needed in cell.needs:
            self._sent.pop(needed.digest, None)
        self._listen()  # the scheduler may be a new one
        return CellEnd("busy")

    def _unknown(self, cell: Cell, end: CellEnd, worker: str) -> CellEnd:
        """Send a cell to another worker, if there is one, since this worker has other versions or plugins."""
        unable = self._unable.setdefault(cell.digest, set())
        unable.add(worker)
        self._remark(f"the worker {worker} cannot run some cells ({end.reason})")
        return CellEnd("busy") if set(self._threads) - unable else end

    def _look(self) -> None:
        """Update the list of workers, at most once per `POLL_INTERVAL`. Raises `SchedulerLost`."""
        now = time.monotonic()
        if now - self._last_look < POLL_INTERVAL:
            return
        self._last_look = now
        if self._client.status not in (RUNNING, "connecting"):
            raise SchedulerLost(f"the scheduler at {self._address} no longer answers: {CONTINUE}")
        with self._unless_lost():
            self._threads = dict(self._client.nthreads())
        self._last_worker = now if self._threads else self._last_worker
        if now - self._last_worker > ALONE:
            self._remark("the scheduler has no worker: waiting for one")
        for future, sent_cell in self._sent_cells.items():
            if sent_cell.only is not None and not sent_cell.only & set(self._threads):
                future.cancel()

    def _listen(self) -> None:
        with self._unless_lost():
            self._client.subscribe_topic(self._run, lambda event: self._events.put(event[1]))

    def _bundles(self, digests: Collection[str]) -> list[distributed.Future[Any]]:
        """Return the results of cells in the cluster, after sending those that are missing there."""
        missing = [digest for digest in digests if digest not in self._sent or self._sent[digest].status != "finished"]
        for digest in missing:
            self._sent[digest] = self._client.scatter([self._store.bundle(digest)], timeout=PATIENCE, hash=False)[0]
        return [self._sent[digest] for digest in digests]

    @contextmanager
    def _unless_lost(self) -> Iterator[None]:
        """Leave the block if the connection is lost (Dask raises several errors) or no worker accepts data."""
        from distributed import TimeoutError as NoWorker
        from distributed.comm.core import CommClosedError

        try:
            yield
        except (NoWorker, CommClosedError):  # raised before the client's status changes
            pass
        except Exception:  # a closed connection may raise anything
            if self._client.status == RUNNING:
                raise


Scheduler: TypeAlias = Union[str, Path, "Client"]
"""``tcp://HOST:PORT``, ``tls://HOST:PORT``, the file that a scheduler wrote, or a Dask client."""
FILE_ENDS = ".json"
SCHEMES = ("tcp://", "tls://", "ws://", "wss://")
CONTINUE = "finished results are kept; rerun the same command to resume, with another scheduler or without one"


@contextmanager
def connected(scheduler: Scheduler) -> Iterator[Client]:
    """Connect to ``scheduler``; a given client stays connected, a new one is closed at the end.

    Certificates for ``tls://`` come from Dask's configuration. Raises `InvalidArgument`, and `SchedulerLost` without an
    answer.
    """
    from distributed import Client, Security

    if isinstance(scheduler, Client):
        if scheduler.asynchronous:
            raise InvalidArgument("scheduler: expected a synchronous Client, got one with asynchronous=True")
        yield scheduler
        return
    address = address_of(str(scheduler))
    if address.startswith("tls://") and Security().get_connection_args("client").get("ssl_context") is None:
        raise InvalidArgument(
            f"scheduler {address}: expected certificates in Dask's configuration, found none; see the page 'A cluster' "
            "of the documentation"
        )
    with _quiet():
        try:
            client = Client(address, set_as_default=False, name="sysid-evo")
        except OSError as error:
            why = (str(error).splitlines() or [type(error).__name__])[0]
            raise SchedulerLost(
                f"no scheduler answers at {address} ({why}): start one with 'dask scheduler' and give the "
                f"address that it prints, or compute without one; {CONTINUE}"
            ) from error
        try:
            yield client
        finally:
            client.close()


@contextmanager
def _quiet() -> Iterator[None]:
    """Suppress the log of Dask's client: a lost scheduler is reported once, as `SchedulerLost`."""
    log = logging.getLogger("distributed.client")
    level = log.level
    log.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        log.setLevel(level)


def address_of(text: str) -> str:
    """Return the address ``text``, or the address in the file ``text``. Raises `InvalidArgument`."""
    if text.endswith(FILE_ENDS):
        try:
            found = json.loads(Path(text).read_text(encoding="utf-8"))["address"]
        except FileNotFoundError:
            raise InvalidArgument(
                f"scheduler: expected the file that 'dask scheduler --scheduler-file {text}' writes, found none"
            ) from None
        except (OSError, ValueError, TypeError, KeyError, RecursionError) as error:
            raise InvalidArgument(f"scheduler: expected the file of a scheduler, got {text}: {error}") from error
        return str(found)
    if not text.startswith(SCHEMES):
        raise InvalidArgument(
            f"scheduler: expected tcp://HOST:PORT, tls://HOST:PORT or the {FILE_ENDS} file of a scheduler, got {text!r}"
        )
    return text


WATCH = 0.5  # s, between two checks whether the task was cancelled
ONE_AT_A_TIME = threading.Lock()
"""Library threads and random numbers belong to the process, so its threads compute one after another."""
STORES: dict[str, Store] = {}
"""The last runs of this worker, each with its own folder."""
MAX_STORES = 4
PLUGINS: dict[str, str] = {}
"""Paths of the received plugin files by their SHA-256."""


class TaskCancelled(BaseException):
    """The result of the current task is no longer needed."""


def compute(task: RemoteTask, needed: Sequence[Bundle]) -> tuple[CellEnd, Bundle, str]:
    """Compute a cell in a worker; return its end, the files of its result if it is done, and the worker's address."""
    from distributed import get_worker

    worker = get_worker()

    def report(*step: int | str) -> None:
        worker.log_event(task.run, (task.digest, *step))

    with ONE_AT_A_TIME, _unless_cancelled(worker), suppress(TaskCancelled):
        store = _store_of(task.run, worker.local_directory)
        for bundle in needed:
            if not (store.path / bundle[0][0]).is_file():
                unpack((*bundle[1:], bundle[0]), store.path)  # the record last, when the result is complete
        os.environ[ENGINE_VARIABLE] = task.engine
        use_processors(1)
        try:
            problem = _load(task.plugins, worker.local_directory)
            end = run_sent(store, task.cell, task.failed, report)
        finally:
            use_processors(0)
        if end.status == "unknown":
            own = versions()
            differing = [
                f"{name} {own.get(name)} instead of {one}"
                for name, one in task.versions.items()
                if own.get(name) != one
            ]
            end = replace(end, reason=", ".join(filter(None, (end.reason, problem, *differing))))
        if end.status == "kept":  # an earlier attempt on this worker finished it
            end = replace(end, status="done")
        return end, store.bundle(task.digest) if end.status == "done" else (), worker.address
    raise CancelledError


def _store_of(run: str, place: str) -> Store:
    """Return the store of this worker for a run; the least recently used are removed."""
    STORES[run] = STORES.pop(run) if run in STORES else Store(tempfile.mkdtemp(prefix="sysid-evo-", dir=place))
    while len(STORES) > MAX_STORES:
        shutil.rmtree(STORES.pop(next(iter(STORES))).path, ignore_errors=True)
    return STORES[run]


def _load(plugins: Bundle, place: str) -> str:
    """Load the received plugin files; return the error message, empty if there is none."""
    for name, _, content in plugins:
        digest = hashlib.sha256(content).hexdigest()
        if digest not in PLUGINS:
            (PLUGINS[digest],) = map(str, unpack(((name, 0, content),), Path(tempfile.mkdtemp(dir=place))))
        try:
            load_plugins_again([PLUGINS[digest]])
        except PluginError as error:
            return str(error)
    return ""


@contextmanager
def _unless_cancelled(worker: Any) -> Iterator[None]:
    """Raise `TaskCancelled` inside when the current task is cancelled."""
    from distributed import Status

    key, thread, ended = worker.get_current_task(), threading.get_ident(), threading.Event()

    def watch() -> None:
        while not ended.wait(WATCH):
            task = worker.state.tasks.get(key)
            if worker.status not in (Status.running, Status.paused) or task is None or task.state != "executing":
                ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread), ctypes.py_object(TaskCancelled))
                return

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield
    finally:
        ended.set()
        watcher.join()
