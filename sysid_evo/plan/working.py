"""The program of a process that computes cells for another one; see `sysid_evo.plan.worker` for the other side."""

from __future__ import annotations

import _thread
import io
import json
import os
import signal
import sys
import threading
import time
import warnings
from contextlib import suppress
from pathlib import Path
from queue import SimpleQueue
from typing import Any, NoReturn

from sysid_evo.plan.again import Again
from sysid_evo.plan.cell import Cell
from sysid_evo.plan.execution import Here
from sysid_evo.plan.ledger import Ledger
from sysid_evo.plan.plan import Plan
from sysid_evo.plan.store import Outcome, Store, StoredCell
from sysid_evo.plan.worker import GRACE
from sysid_evo.processors import use_processors

OFTEN = 0.1  # s, between two reports of progress
INTERRUPTED = 130


def main() -> None:
    """Compute what is asked for, until nobody is there to ask."""
    signal.signal(signal.SIGTERM, _stop)
    try:
        master = Master()
        warnings.showwarning = master.warn
        serve(master)
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)


def _stop(*_: Any) -> NoReturn:
    raise KeyboardInterrupt


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


class Telling:
    """An observer that tells the master."""

    def __init__(self, master: Master) -> None:
        self._master = master
        self._next = 0.0

    def plan(self, cells: int, kept: int, seconds: float) -> None:
        pass

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
    known = {cell.digest: cell for cell in plan if not isinstance(cell, StoredCell)}
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
