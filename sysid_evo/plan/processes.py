"""Worker processes on this machine, each with its own executor: a worker that crashes affects its own cell only."""

from __future__ import annotations

import importlib
import json
import os
import re
import shutil
import signal
import tempfile
import threading
import time
from collections.abc import Collection, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Future, wait
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from sysid_evo.plan.cell import Cell
from sysid_evo.plan.run_cell import CellEnd, CellLost, pickled, run_sent
from sysid_evo.plan.store import Store
from sysid_evo.processors import INNER_THREADS, shared_counts, usable_processors, use_shared_count
from sysid_evo.registry.plugins import load_plugins_again, loaded_plugins

GRACE = 10.0  # s, for a worker to write its checkpoint
WATCH = 0.5  # s, between two checks of a worker whether its parent is alive
INTERRUPTED = 130
SHARES = "processors"


class Slot:
    """Worker process number ``number``, which is restarted after it died; it writes its progress to ``note``."""

    def __init__(self, number: int, note: Path, *arguments: Any) -> None:
        self.number, self.note, self._arguments = number, note, (number, note, *arguments)
        self.cell: Cell | None = None
        self.start()

    def start(self) -> None:
        """Start the process."""
        from joblib.externals.loky import ProcessPoolExecutor

        environment = {name: os.environ.get(name, "1") for name in INNER_THREADS} | SAFE
        self.executor = ProcessPoolExecutor(1, env=environment, initializer=begin, initargs=self._arguments)
        with _uninterrupted():
            self._process: Future[int] = self.executor.submit(os.getpid)

    def submit(self, cell: Cell, *arguments: Any) -> Future[CellEnd]:
        """Send ``cell`` to the process."""
        self.cell = cell
        try:
            return self.executor.submit(compute, cell.digest, *arguments)
        except BrokenExecutor:  # it died while it was idle
            self.start()
            return self.executor.submit(compute, cell.digest, *arguments)

    def step(self) -> tuple[int, int, str] | None:
        """Return steps done, steps in total and a note of the current cell; None if unknown."""
        try:
            digest, *step = json.loads(self.note.read_text(encoding="utf-8"))
        except (OSError, ValueError):  # not begun, or just being written
            return None
        done, total, note = step
        return (done, total, note) if self.cell is not None and digest == self.cell.digest else None

    def interrupt(self) -> bool:
        """Ask the process to write its checkpoint and end; return False if it has not started."""
        if not self._process.done() or self._process.exception() is not None:
            return False
        with suppress(ProcessLookupError):
            os.kill(self._process.result(), signal.SIGTERM)
        return True

    def stop(self, *, kill: bool) -> None:
        """End the process when it is idle, or at once with ``kill``."""
        self.executor.shutdown(wait=True, kill_workers=kill)


class Processes:
    """Up to ``jobs`` worker processes for the ``cells`` of a plan; their engines share the processors."""

    def __init__(self, store: Store, cells: Sequence[Cell], jobs: int) -> None:
        self._store, self._jobs = store, jobs
        self._modules = sorted({type(cell.settings).__module__ for cell in cells})
        self._busy: dict[Future[Any], Slot] = {}

    def __enter__(self) -> Self:
        _start_trackers()
        self._folder = Path(tempfile.mkdtemp(prefix="sysid-evo-"))
        (self._folder / SHARES).write_bytes(bytes(2 * self._jobs))
        self._shares = shared_counts(self._folder / SHARES)
        arguments = (os.getpid(), str(self._store.path), loaded_plugins(), self._modules)
        self._slots = [Slot(i, self._folder / str(i), *arguments) for i in range(self._jobs)]
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            wait([future for future, slot in self._busy.items() if slot.interrupt()], timeout=GRACE)
        finally:  # also when Ctrl-C is pressed again
            for slot in self._slots:
                slot.stop(kill=kind is not None)
            shutil.rmtree(self._folder, ignore_errors=True)

    def n_idle(self) -> int:
        """Return the number of idle workers."""
        return len(self._slots) - len(self._busy)

    def submit(self, cell: Cell, failed: Collection[str]) -> Future[CellEnd]:
        """Send ``cell`` to an idle worker. Raises `Unsendable`."""
        sent = pickled(cell, self._store)
        slot = next(slot for slot in self._slots if slot.cell is None)
        future = slot.submit(cell, sent, tuple(failed))
        self._busy[future] = slot
        self._share_processors()
        return future

    def result(self, cell: Cell, future: Future[CellEnd]) -> CellEnd:
        """Return the end of ``cell``. Raises `CellLost`, OSError if its result could not be written."""
        slot = self._busy.pop(future)
        slot.cell = None
        try:
            return future.result()
        except BrokenExecutor as error:
            codes = re.search(r"\{(.+)\}", str(error))
            how = codes[1] if codes else "without an exit code"
            if "SIGKILL" in how and len(self._slots) > 1:  # perhaps out of memory: continue with fewer workers
                self._slots.remove(slot)
            else:
                slot.start()
            raise CellLost(f"its worker died ({how})") from error
        finally:
            self._share_processors()

    def progress(self) -> Iterator[tuple[Cell, int, int, str]]:
        """Yield the progress of the cells."""
        for slot in self._busy.values():
            if slot.cell is not None and (step := slot.step()) is not None:
                yield slot.cell, *step

    def _share_processors(self) -> None:
        """Divide the processors among the busy workers; the longest cells get the remainder."""
        working = sorted(self._busy.values(), key=lambda slot: -slot.cell.expected_seconds if slot.cell else 0.0)
        processors = usable_processors()
        for i, slot in enumerate(working):
            self._shares[slot.number] = max(1, processors // len(working) + (i < processors % len(working)))


SAFE = {"PYTHONSAFEPATH": "1"}
"""Environment of a Python process that must not import modules of the current folder, such as ./json.py."""


def _start_trackers() -> None:
    """Start the two resource tracker processes with a safe import path and without warnings."""
    from joblib.externals.loky.backend import resource_tracker as of_loky

    before = dict(os.environ)
    os.environ.update(SAFE, PYTHONWARNINGS="ignore")
    try:
        resource_tracker.ensure_running()
        of_loky.ensure_running()
    finally:
        os.environ.clear()
        os.environ.update(before)


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Start processes inside that ignore Ctrl-C: this process handles it and ends them in order."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class _Work:
    """Store and progress file of this process, if it is a worker."""

    store: Store
    note: Path


def begin(number: int, note: Path, parent: int, folder: str, plugins: Sequence[str], modules: Sequence[str]) -> None:
    """Make this process a worker of ``parent``."""
    from joblib.externals.loky import process_executor

    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with suppress(OSError):  # a daemon has neither
        os.dup2(2, 1)  # what libraries print is no output of the command
    threading.Thread(target=_watch, args=(parent, note.parent), daemon=True).start()
    process_executor._USE_PSUTIL = False  # libraries that a cell loads are not a memory leak
    use_shared_count(note.with_name(SHARES), number)
    _Work.store, _Work.note = Store(folder), note
    with suppress(Exception):  # the error is reported when a cell needs the plugin
        load_plugins_again(plugins)
        for module in modules:
            importlib.import_module(module)


def _watch(parent: int, folder: Path) -> None:
    """End this process when its parent has ended, after the cell had time to write its checkpoint."""
    while os.getppid() == parent:
        time.sleep(WATCH)
    shutil.rmtree(folder, ignore_errors=True)
    main = threading.main_thread().ident
    assert main is not None
    signal.pthread_kill(main, signal.SIGTERM)
    time.sleep(GRACE)
    os._exit(INTERRUPTED)


def compute(digest: str, sent: bytes, failed: Collection[str]) -> CellEnd:
    """Compute a cell for the parent of this process."""

    def report(*step: int | str) -> None:
        with suppress(OSError):  # the parent has ended
            _Work.note.write_text(json.dumps([digest, *step]), encoding="utf-8")

    try:
        return run_sent(_Work.store, sent, failed, report)
    except KeyboardInterrupt:
        os._exit(INTERRUPTED)
