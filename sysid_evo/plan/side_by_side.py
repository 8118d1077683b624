"""Computes the cells of a plan side by side, in processes that share its store."""

from __future__ import annotations

import signal
import time
import warnings
from collections.abc import Sequence
from queue import Empty, SimpleQueue
from typing import Any

from sysid_evo.plan.again import Again
from sysid_evo.plan.cell import Cell
from sysid_evo.plan.execution import PATIENCE, Here
from sysid_evo.plan.ledger import Ledger
from sysid_evo.plan.plan import Plan
from sysid_evo.plan.worker import Inbox, Worker, said_of
from sysid_evo.processors import usable_processors

TRIES = 2
"""How often a cell is tried whose process ends without a word."""


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
            self._dismiss_all()

    def _hire(self) -> Worker:
        worker = Worker(self.inbox)
        worker.say(function=self.again.function, settings=self.again.settings)
        self.coming.add(worker)
        return worker

    def _dismiss_all(self) -> None:
        for worker in (*self.at, *self.coming):
            worker.dismiss()
        for worker in (*self.at, *self.coming):
            worker.wait()

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


def work_ahead(plan: Plan) -> dict[str, float]:
    """Return by digest the seconds from the beginning of each cell to the end of all that waits for it in turn."""
    ahead = {cell.digest: cell.seconds() for cell in plan}
    for cell in reversed(plan.cells):
        for needed in cell.needs:
            ahead[needed.digest] = max(ahead[needed.digest], needed.seconds() + ahead[cell.digest])
    return ahead
