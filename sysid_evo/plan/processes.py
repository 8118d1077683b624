"""The cells of a plan side by side, in processes that share its store, and the program of these processes.

Both sides talk in lines of JSON, on standard input and output: nothing but digests, numbers and sentences. Results go
through the store.
"""

from __future__ import annotations

import _thread
import io
import json
import os
import signal
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Any, TypeAlias

from sysid_evo.plan.cell import Cell
from sysid_evo.plan.plan import Again, Plan, work_ahead
from sysid_evo.plan.run_state import PATIENCE, TRIES, Here, Ledger, Observer
from sysid_evo.plan.store import Outcome, Store
from sysid_evo.processors import ENGINE_VARIABLE, INNER_THREADS, resolve, usable_processors, use_processors


class SideBySide:
    """Hands cells to ``jobs`` processes, those first on whose results most work waits.

    The processes make the plan ``again``. What they do not know of it is computed in this one. Where fewer cells are
    computed than there are processors, the engine inside uses the idle ones.
    """

    def __init__(self, ledger: Ledger, again: Again, jobs: int) -> None:
        self.ledger, self.again, self.jobs = ledger, again, jobs
        self.here = Here(ledger)
        self.inbox: Inbox = SimpleQueue()
        self.at: dict[Worker, Cell | None] = {}  # what each computes that has made the plan
        self.coming: set[Worker] = set()  # those that have not made it yet
        self.known: set[str] = set()
        self.threads: dict[Worker, int] = {}
        self.began: dict[str, float] = {}
        self.tried: dict[str, int] = {}
        self.elsewhere: dict[str, float] = {}  # when to look again at what another process computes
        self.cells = {cell.digest: cell for cell in ledger.plan}
        self.ahead = work_ahead(ledger.plan)

    def to_the_end(self, cells: Sequence[Cell]) -> None:
        """Bring all of ``cells`` to their end. Raises OSError if a result cannot be written."""
        try:
            for _ in range(self.jobs):
                self._hire()
            first = [cell for cell in cells if cell.digest in self.again.after]
            self.here.to_the_end(first)
            if any(self.ledger.ended[cell.digest].failed for cell in first):
                self.here.to_the_end(cells)
            for worker in self.coming:
                worker.say(folder=str(self.ledger.store.path))
            left = self.ledger.left(cells)
            while left:
                ended = len(self.ledger.ended)
                self._hand_out(left)
                self._hear()
                if len(self.ledger.ended) != ended:  # a plan may have ten thousand cells: not after every word
                    left = self.ledger.left(left)
        finally:
            for worker in (*self.at, *self.coming):
                worker.dismiss()
            for worker in (*self.at, *self.coming):
                worker.wait()

    def _hire(self) -> Worker:
        worker = Worker(self.inbox)
        worker.say(function=self.again.function, settings=self.again.settings, engine=resolve())
        self.coming.add(worker)
        return worker

    def _hand_out(self, left: Sequence[Cell]) -> None:
        """Give every idle process a cell that waits for nothing; compute one here if only this process can."""
        if self.at and all(self.at.values()) and self.known >= self.cells.keys():
            return
        now = time.monotonic()
        busy = set(self.at.values())
        ready = [
            cell
            for cell in left
            if cell not in busy and not self.ledger.waits(cell) and self.elsewhere.get(cell.digest, 0.0) <= now
        ]
        ready.sort(key=lambda cell: -self.ahead[cell.digest])
        for worker in [worker for worker, cell in self.at.items() if cell is None]:
            chosen = next((cell for cell in ready if cell.digest in self.known), None)
            if chosen is None:
                break
            ready.remove(chosen)
            self.at[worker] = chosen
            self.began[chosen.digest] = now
            failed = [digest for digest, outcome in self.ledger.ended.items() if outcome.failed]
            worker.say(compute=chosen.digest, failed=failed)
        self._share_processors()
        if not self.coming:
            own = next((cell for cell in ready if not self.at or cell.digest not in self.known), None)
            if own is not None and not self.here.attempt(own):
                self.elsewhere[own.digest] = now + PATIENCE

    def _share_processors(self) -> None:
        """Give every cell that is computed its share of the processors, the longest the rest."""
        working = [(worker, cell) for worker, cell in self.at.items() if cell is not None]
        working.sort(key=lambda pair: -self.ahead[pair[1].digest])
        processors = usable_processors()
        for i, (worker, _) in enumerate(working):
            threads = max(1, processors // len(working) + (i < processors % len(working)))
            if self.threads.get(worker) != threads:
                self.threads[worker] = threads
                worker.say(threads=threads)

    def _hear(self) -> None:
        """Take in what the processes have said; wait for it if they are at work."""
        if not self.at and not self.coming:
            time.sleep(PATIENCE if self.elsewhere else 0.0)
            return
        try:
            worker, message = self.inbox.get(timeout=PATIENCE if self.elsewhere else 1.0)
        except Empty:
            return
        if message is None:
            self._ended(worker)
        elif "knows" in message:
            self.coming.discard(worker)
            self.at[worker] = None
            self.known = set(message["knows"])
        elif "cannot" in message:
            self.ledger.tell(f"all is computed in this process: others cannot plan this work ({message['cannot']})")
        elif "stop" in message:
            raise OSError(*message["stop"])
        elif "idle" in message:
            self.at[worker] = None
            if not message["ended"]:
                self.elsewhere[message["idle"]] = time.monotonic() + PATIENCE
        else:
            self._told(message)

    def _told(self, message: dict[str, Any]) -> None:
        """Hand on to the observer what a process says about its cell."""
        observer = self.ledger.observer
        if "start" in message:
            observer.start(self.cells[message["start"]])
        elif "progress" in message:
            observer.progress(self.cells[message["progress"]], message["done"], message["total"], message["note"])
        elif "end" in message:
            cell = self.cells[message["end"]]
            self.ledger.end(cell, message["reason"], self.ledger.seconds(cell), cached=message["cached"])
        elif "remark" in message:
            self.ledger.tell(message["remark"])
        elif "warning" in message:
            warnings.warn(message["warning"], stacklevel=2)

    def _ended(self, worker: Worker) -> None:
        """A process has ended unasked: its cell is tried once more, then it counts as failed."""
        self.coming.discard(worker)
        worker.dismiss()
        code = worker.wait()
        why = said_of(code)
        if worker not in self.at:
            if code != 0:
                self.ledger.tell(f"a process that was to compute cells ended before it began ({why})")
            return
        cell = self.at.pop(worker)
        if cell is not None and cell.digest not in self.ledger.ended:
            self.tried[cell.digest] = self.tried.get(cell.digest, 0) + 1
            if self.tried[cell.digest] >= TRIES:
                seconds = time.monotonic() - self.began[cell.digest]
                self.ledger.fail(cell, f"its process ended {TRIES} times ({why})", "", seconds)
            else:
                self.ledger.tell(f"the process of {cell.title} ended ({why}): it is computed again")
        if code != -getattr(signal, "SIGKILL", 9) or not (self.at or self.coming):  # killed: fewer need less memory
            self._hire().say(folder=str(self.ledger.store.path))


PROGRAM = "import json, sys; sys.path[:] = json.loads(sys.argv[1]); from sysid_evo.plan.processes import main; main()"

GRACE = 10.0  # s, in which a process may write down what it has so far
Inbox: TypeAlias = "SimpleQueue[tuple[Worker, dict[str, Any] | None]]"
"""What workers say; None is the last of each."""


class Worker:
    """A process of its own, with one inner thread; what it says goes into ``inbox``."""

    def __init__(self, inbox: Inbox) -> None:
        environment = dict.fromkeys(INNER_THREADS, "1") | dict(os.environ)
        command = [sys.executable, "-P", "-c", PROGRAM, json.dumps(sys.path)]  # -P: no ./json.py of the current folder
        with _uninterrupted():
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, encoding="utf-8", env=environment
            )
        self._inbox = inbox
        Thread(target=self._listen, daemon=True).start()

    def say(self, **message: Any) -> None:
        """Say something to the process; that it has ended is heard in the inbox."""
        assert self._process.stdin is not None
        with suppress(OSError, ValueError):  # ValueError: dismissed
            self._process.stdin.write(json.dumps(message) + "\n")
            self._process.stdin.flush()

    def dismiss(self) -> None:
        """Let the process end: at once if it is idle, else as soon as it has written down how far it is."""
        assert self._process.stdin is not None
        with suppress(OSError):
            self._process.stdin.close()

    def wait(self) -> int:
        """Return the exit code of a process that was dismissed, or ended; one that takes too long is killed."""
        try:
            return self._process.wait(GRACE)
        except (subprocess.TimeoutExpired, KeyboardInterrupt):
            self._process.kill()
            return self._process.wait()

    def _listen(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as lines:
            for line in lines:
                self._inbox.put((self, json.loads(line)))
        self._inbox.put((self, None))


def said_of(code: int) -> str:
    """Return the exit ``code`` of a process as people say it."""
    return signal.Signals(-code).name if code < 0 else f"exit code {code}"


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Let processes that are started inside be deaf to Ctrl-C: this one hears it, and ends them in good order."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


OFTEN = 0.1  # s, between two reports of progress
INTERRUPTED = 130


def main() -> None:
    """Compute what is asked for, until nobody is there to ask."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        master = Master()
        warnings.showwarning = master.warn
        serve(master)
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)


class Master:
    """The process that hands out cells. What it says is heard at once; that it has gone interrupts the work."""

    def __init__(self) -> None:
        self._tongue = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what libraries print is no message
        self._heard: SimpleQueue[dict[str, Any] | None] = SimpleQueue()
        self._given, self._done = 0, -1
        threading.Thread(target=self._listen, daemon=True).start()

    def say(self, **message: Any) -> None:
        """Say something. Raises KeyboardInterrupt if nobody hears it."""
        try:
            self._tongue.write(json.dumps(message) + "\n")
            self._tongue.flush()
        except OSError:
            raise KeyboardInterrupt from None

    def warn(self, message: Warning | str, *_: object, **__: object) -> None:
        """Hand a warning on."""
        self.say(warning=str(message))

    def next(self) -> dict[str, Any] | None:
        """Wait for the next order, now that the one before is done; None is the last."""
        self._done += 1
        return self._heard.get()

    def _listen(self) -> None:
        for line in io.FileIO(sys.stdin.fileno(), closefd=False):  # no buffer, whose lock would be held at the end
            order = json.loads(line)
            if "threads" in order:
                use_processors(order["threads"])
            if len(order) > ("threads" in order):
                self._given += 1
                self._heard.put(order)
        self._heard.put(None)
        if self._given > self._done:
            _interrupt_main()
        time.sleep(GRACE)
        os._exit(INTERRUPTED)


def _interrupt_main() -> None:
    """Interrupt what the main thread does; where the system can do it, also what it waits for."""
    main_thread = threading.main_thread().ident
    if hasattr(signal, "pthread_kill") and main_thread is not None:
        signal.pthread_kill(main_thread, signal.SIGTERM)
    else:
        _thread.interrupt_main(signal.SIGTERM)


class Telling(Observer):
    """An observer that tells the master."""

    def __init__(self, master: Master) -> None:
        self._master = master
        self._next = 0.0

    def start(self, cell: Cell) -> None:
        self._next = 0.0
        self._master.say(start=cell.digest)

    def progress(self, cell: Cell, done: int, total: int, note: str = "") -> None:
        now = time.monotonic()
        if now >= self._next:
            self._next = now + OFTEN
            self._master.say(progress=cell.digest, done=done, total=total, note=note)

    def finish(self, cell: Cell, *, cached: bool, reason: str | None) -> None:
        self._master.say(end=cell.digest, cached=cached, reason=reason)

    def remark(self, sentence: str) -> None:
        self._master.say(remark=sentence)


def serve(master: Master) -> None:
    """Prepare, make the plan again when that can be done, and compute one cell after the other."""
    order = master.next()
    if order is None:
        return
    again = Again(order["function"], order["settings"])
    os.environ[ENGINE_VARIABLE] = order["engine"]  # workers of a cluster have the environment of their own machine
    with suppress(Exception):  # what is wrong is told when the plan is made
        again.prepare()
    order = master.next()
    if order is None:
        return
    store = Store(Path(order["folder"]))
    try:
        plan = again.plan(store.path)
    except Exception as error:  # what cannot be made here can be where it was made first
        master.say(cannot=f"{type(error).__name__}: {error}")
        return
    known = {cell.digest: cell for cell in plan if not cell.known_digest}
    ledger = Ledger(plan, store, Telling(master))
    master.say(knows=list(known))
    while (order := master.next()) is not None:
        cell = known[order["compute"]]
        ledger.only = (cell,) if order.get("alone") else None
        _open(ledger, cell, set(order["failed"]))
        try:
            ended = Here(ledger).attempt(cell)
        except OSError as error:  # a full disk stops all cells
            master.say(stop=[error.errno, error.strerror or str(error), error.filename])
            return
        master.say(idle=cell.digest, ended=ended)


def _open(ledger: Ledger, cell: Cell, failed: set[str]) -> None:
    """Put down what is known of all that ``cell`` is made of."""
    ledger.ended.pop(cell.digest, None)
    for needed in Plan.of(cell.needs):
        reason = "failed" if needed.digest in failed else None
        ledger.ended[needed.digest] = Outcome(None, reason, 0.0)
