"""The cells of a plan on the workers of a Dask cluster, which need not see the run folder.

A cell travels pickled in memory, results as the bytes of their files. This process alone writes the run folder, as
results come in: what is finished is here, whatever dies there. The lower half of this module runs in the workers.
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

LOOK = 1.0  # s, between two looks at who is there
ALONE = 5.0  # s without workers, after which that is told
PATIENCE = 5.0  # s, to wait for a worker that takes data
LOST = 20
"""How often a cell is sent whose data are lost on the way."""
AHEAD = 2
"""Cells that are sent for every thread of the workers, so that none waits for this process."""
FIRST = 16
"""Cells that are sent while there are no workers: a cluster that grows with its work sees some."""
RUNNING = "running"


@dataclass(frozen=True)
class RemoteTask:
    """A pickled cell, which of its needs failed, and what a worker must have loaded, in the run called ``run``."""

    run: str
    digest: str
    cell: bytes
    failed: tuple[str, ...]
    engine: str
    plugins: Bundle
    versions: dict[str, str]


@dataclass
class Away:
    """A cell that was sent: our claim on it, and the workers it is restricted to, if it is."""

    cell: Cell
    claim: ExitStack
    only: frozenset[str] | None = None


class DaskExecutor:
    """The workers of ``scheduler``, for the ``cells`` of a plan; ``tell`` passes a remark on to the user.

    Results that cells need are sent once and stay in the cluster as long as one of the cells needs them.
    """

    def __init__(self, store: Store, cells: Sequence[Cell], scheduler: Scheduler, tell: Callable[[str], None]) -> None:
        self._store, self._scheduler, self._tell = store, scheduler, tell
        self._away: dict[Future[Any], Away] = {}
        self._users = Counter(digest for cell in cells for digest in {needed.digest for needed in cell.needs})
        self._sent: dict[str, distributed.Future[Any]] = {}
        self._unable: dict[str, set[str]] = {}  # workers that do not know a cell
        self._lost: Counter[str] = Counter()
        self._said: SimpleQueue[tuple[str, int, int, str]] = SimpleQueue()
        self._threads: dict[str, int] = {}
        self._looked, self._seen = 0.0, time.monotonic()
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
            for away in self._away.values():
                away.claim.close()
            if self._client.status == RUNNING:
                with self._unless_lost():
                    self._executor.shutdown(wait=False)
                    self._client.unsubscribe_topic(self._run)
            self._sent.clear()

    def room(self) -> int:
        """Return how many more cells to send. Raises `SchedulerLost`."""
        self._look()
        if self._client.status != RUNNING:
            return 0
        return (AHEAD * sum(self._threads.values()) or FIRST) - len(self._away)

    def submit(self, cell: Cell, failed: Collection[str]) -> Future[Any] | None:
        """Send ``cell``; None if another process is at it, or nobody is there now. Raises `Unsendable`."""
        future: Future[Any] | None = None
        with ExitStack() as claim:
            if not claim.enter_context(self._store.claim(cell)):
                return None
            if self._store.done(cell) and self._store.without(cell) == set(failed):
                future = Future()
                future.set_result((CellEnd("kept", self._store.seconds(cell)), (), ""))
                self._away[future] = Away(cell, claim.pop_all())
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
                self._away[future] = Away(cell, claim.pop_all(), only)
        return future

    def result(self, cell: Cell, future: Future[Any]) -> CellEnd:
        """Put down the result of ``cell`` and return how it ended. Raises `CellLost`, OSError if the disk is full."""
        from distributed import KilledWorker

        with self._away.pop(future).claim:
            try:
                end, bundle, worker = future.result()
            except CancelledError:
                return self._again(cell)
            except KilledWorker as error:
                times = error.allowed_failures + 1
                return self._failed(cell, f"{times} worker{'s' if times > 1 else ''} died while it was there")
            except Exception as error:  # whatever a worker without this version raises
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
        """Yield what workers have said since the last time."""
        cells = {away.cell.digest: away.cell for away in self._away.values()}
        with suppress(Empty):
            while True:
                digest, done, total, note = self._said.get_nowait()
                if digest in cells:
                    yield cells[digest], done, total, note

    def _failed(self, cell: Cell, reason: str) -> CellEnd:
        self._store.fail(cell, reason=reason, traceback="", seconds=0.0)
        return CellEnd("failed", reason=reason)

    def _again(self, cell: Cell) -> CellEnd:
        """A cell, or what it needs, was lost in the cluster: all of it is sent again."""
        self._looked = 0.0  # the next look says whether the scheduler is there
        self._lost[cell.digest] += 1
        if self._lost[cell.digest] > LOST:
            return self._failed(cell, f"it, or what it needs, was lost in the cluster {LOST} times")
        for needed in cell.needs:
            self._sent.pop(needed.digest, None)
        self._listen()  # to the new scheduler, if it is one
        return CellEnd("busy")

    def _unknown(self, cell: Cell, end: CellEnd, worker: str) -> CellEnd:
        """A worker has another version of something: another one is asked, if there is one."""
        unable = self._unable.setdefault(cell.digest, set())
        unable.add(worker)
        self._tell(f"the worker {worker} does not know all of this work ({end.reason})")
        return CellEnd("busy") if set(self._threads) - unable else end

    def _look(self) -> None:
        """See, now and then, who is there. Raises `SchedulerLost`."""
        now = time.monotonic()
        if now - self._looked < LOOK:
            return
        self._looked = now
        if self._client.status not in (RUNNING, "connecting"):
            raise SchedulerLost(f"the scheduler at {self._address} does not answer any more: {GO_ON}")
        with self._unless_lost():
            self._threads = dict(self._client.nthreads())
        self._seen = now if self._threads else self._seen
        if now - self._seen > ALONE:
            self._tell("there is no worker: waiting for one")
        for future, away in self._away.items():
            if away.only is not None and not away.only & set(self._threads):
                future.cancel()

    def _listen(self) -> None:
        with self._unless_lost():
            self._client.subscribe_topic(self._run, lambda event: self._said.put(event[1]))

    def _bundles(self, digests: Collection[str]) -> list[distributed.Future[Any]]:
        """Return the results of cells in the cluster; those that are not there are sent."""
        missing = [digest for digest in digests if digest not in self._sent or self._sent[digest].status != "finished"]
        for digest in missing:
            self._sent[digest] = self._client.scatter([self._store.bundle(digest)], timeout=PATIENCE, hash=False)[0]
        return [self._sent[digest] for digest in digests]

    @contextmanager
    def _unless_lost(self) -> Iterator[None]:
        """Leave the block at once where the connection breaks, which Dask tells in many ways, or nobody takes data."""
        from distributed import TimeoutError as NobodyThere
        from distributed.comm.core import CommClosedError

        try:
            yield
        except (NobodyThere, CommClosedError):  # that it is closed may be heard before the client knows it
            pass
        except Exception:  # whatever a closed connection raises
            if self._client.status == RUNNING:
                raise


Scheduler: TypeAlias = Union[str, Path, "Client"]
"""``tcp://HOST:PORT``, ``tls://HOST:PORT``, the file that a scheduler wrote, or a client of it."""
FILE_ENDS = ".json"
SCHEMES = ("tcp://", "tls://", "ws://", "wss://")
GO_ON = (
    "what was finished until then is kept, and the same command goes on from there, with another scheduler or without"
)


@contextmanager
def connected(scheduler: Scheduler) -> Iterator[Client]:
    """Connect to ``scheduler``; a client that was given stays connected, another one is closed in the end.

    Certificates for ``tls://`` are those of Dask's configuration. Raises `InvalidArgument`, and `SchedulerLost` if
    nobody answers there.
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
            f"scheduler {address}: expected certificates in Dask's configuration, found none; the page 'A cluster' of "
            "the documentation tells how to make them and where they are named"
        )
    with _quiet():
        try:
            client = Client(address, set_as_default=False, name="sysid-evo")
        except OSError as error:
            why = (str(error).splitlines() or [type(error).__name__])[0]
            raise SchedulerLost(
                f"no scheduler answers at {address} ({why}): start one with 'dask scheduler', name the "
                f"address that it prints, or compute without one; {GO_ON}"
            ) from error
        try:
            yield client
        finally:
            client.close()


@contextmanager
def _quiet() -> Iterator[None]:
    """Let Dask's client log nothing: that a scheduler is lost is an error of ours, told once."""
    log = logging.getLogger("distributed.client")
    level = log.level
    log.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        log.setLevel(level)


def address_of(text: str) -> str:
    """Return the address that ``text`` is, or that stands in the file that it names. Raises `InvalidArgument`."""
    if text.endswith(FILE_ENDS):
        try:
            found = json.loads(Path(text).read_text(encoding="utf-8"))["address"]
        except FileNotFoundError:
            raise InvalidArgument(
                f"scheduler: expected the file that 'dask scheduler --scheduler-file {text}' writes, found none"
            ) from None
        except (OSError, ValueError, TypeError, KeyError, RecursionError) as error:
            raise InvalidArgument(f"scheduler: expected the file of a scheduler, {text} is none: {error}") from error
        return str(found)
    if not text.startswith(SCHEMES):
        raise InvalidArgument(
            f"scheduler: expected tcp://HOST:PORT, tls://HOST:PORT or the {FILE_ENDS} file of a scheduler, got {text!r}"
        )
    return text


WATCH = 0.5  # s, between two looks at whether the result is still wanted
ONE_AT_A_TIME = threading.Lock()
"""Threads of libraries and random numbers belong to the process: its threads take turns."""
STORES: dict[str, Store] = {}
"""The last runs that this worker computed for, each with a folder of its own."""
FEW = 4
PLUGINS: dict[str, str] = {}
"""Where plugin files stand that were sent, by their SHA-256."""


class Unwanted(BaseException):
    """Nobody waits for the result any more."""


def compute(task: RemoteTask, needed: Sequence[Bundle]) -> tuple[CellEnd, Bundle, str]:
    """Compute a cell in a worker; return how it ended, the files of its result if it is done, and the worker."""
    from distributed import get_worker

    worker = get_worker()

    def say(*step: int | str) -> None:
        worker.log_event(task.run, (task.digest, *step))

    with ONE_AT_A_TIME, _while_wanted(worker), suppress(Unwanted):
        store = _store_of(task.run, worker.local_directory)
        for bundle in needed:
            if not (store.path / bundle[0][0]).is_file():
                unpack((*bundle[1:], bundle[0]), store.path)  # the record last: then the result is whole
        os.environ[ENGINE_VARIABLE] = task.engine
        use_processors(1)
        try:
            problem = _load(task.plugins, worker.local_directory)
            end = run_sent(store, task.cell, task.failed, say)
        finally:
            use_processors(0)
        if end.status == "unknown":
            ours = versions()
            differing = [
                f"{name} {ours.get(name)} instead of {one}"
                for name, one in task.versions.items()
                if ours.get(name) != one
            ]
            end = replace(end, reason=", ".join(filter(None, (end.reason, problem, *differing))))
        if end.status == "kept":  # here: another attempt had finished it
            end = replace(end, status="done")
        return end, store.bundle(task.digest) if end.status == "done" else (), worker.address
    raise CancelledError


def _store_of(run: str, place: str) -> Store:
    """Return the folder of this worker for a run; those not used for longest are removed."""
    STORES[run] = STORES.pop(run) if run in STORES else Store(tempfile.mkdtemp(prefix="sysid-evo-", dir=place))
    while len(STORES) > FEW:
        shutil.rmtree(STORES.pop(next(iter(STORES))).path, ignore_errors=True)
    return STORES[run]


def _load(plugins: Bundle, place: str) -> str:
    """Load plugin files that were sent; return what is wrong with them."""
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
def _while_wanted(worker: Any) -> Iterator[None]:
    """Raise `Unwanted` inside when nobody waits for the result of the present task any more."""
    from distributed import Status

    key, thread, over = worker.get_current_task(), threading.get_ident(), threading.Event()

    def watch() -> None:
        while not over.wait(WATCH):
            task = worker.state.tasks.get(key)
            if worker.status not in (Status.running, Status.paused) or task is None or task.state != "executing":
                ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread), ctypes.py_object(Unwanted))
                return

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield
    finally:
        over.set()
        watcher.join()
