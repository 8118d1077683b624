"""How the cells of a plan have ended so far, which can start now, and computing one in this process."""

from __future__ import annotations

import time
import traceback
from collections.abc import Collection, Sequence
from functools import partial
from typing import Any

from sysid_evo.errors import ArtefactError, Blocked, InvalidArgument, SysidEvoError, described
from sysid_evo.plan.cell import Cell, Work
from sysid_evo.plan.plan import Plan
from sysid_evo.plan.store import Outcome, Store, blocked_by
from sysid_evo.processors import one_blas_thread

PATIENCE = 0.1  # s between two looks at cells that another process computes

TRIES = 2
"""How often a cell is tried whose process ends without a word."""


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


class Ledger:
    """How the cells of ``plan`` ended so far, by digest; the observer is told of each.

    With ``only``, no others are computed: what they gave is what the store knows.
    """

    def __init__(
        self, plan: Plan, store: Store, observer: Observer | None = None, only: Collection[Cell] | None = None
    ) -> None:
        self.plan, self.store, self.observer, self.only = plan, store, observer or Observer(), only
        self.ended: dict[str, Outcome] = {}
        self._told: set[str] = set()

    def open(self) -> list[Cell]:
        """End every cell whose result is there; return the others, in the order of the plan."""
        kept = [cell for cell in self.plan if self.store.done(cell) and not self.without(cell)]
        self.tell()
        known = set(kept)
        left = [cell for cell in self.plan if cell not in known]
        self.observer.plan(len(self.plan), len(kept), sum(cell.seconds for cell in left))
        for cell in kept:
            self.end(cell, None, self.seconds(cell), cached=True)
        return left

    def waits(self, cell: Cell) -> bool:
        """Whether something that ``cell`` needs has not ended."""
        return any(needed.digest not in self.ended for needed in cell.needs)

    def decided(self, cell: Cell) -> bool:
        """Whether ``cell``, which waits for nothing, ends without work: what it needs failed, or nobody wants it."""
        failed = [needed for needed in cell.needs if self.ended[needed.digest].failed]
        if failed and not cell.tolerant:
            self.end(cell, blocked_by(failed[0]), 0.0)
            return True
        if self.only is not None and cell not in self.only:
            known = self.store.outcome(cell)
            self.end(cell, known.reason, known.seconds, cached=True)
            return True
        return False

    def left(self, cells: Collection[Cell]) -> list[Cell]:
        """Return those of ``cells`` that have not ended, and cannot without work as things stand."""
        for cell in cells:
            if cell.digest not in self.ended and not self.waits(cell):
                self.decided(cell)
        return [cell for cell in cells if cell.digest not in self.ended]

    def found(self, cell: Cell) -> bool:
        """Whether another process has computed ``cell``, of all that there is to compute it of; it has ended then."""
        failed = {needed.digest for needed in cell.needs if self.ended[needed.digest].failed}
        if not self.store.done(cell) or self.without(cell) != failed:
            return False
        self.end(cell, None, self.seconds(cell), cached=True)
        return True

    def end(
        self, cell: Cell, reason: str | None, seconds: float, *, cached: bool = False, error: Exception | None = None
    ) -> None:
        """Put down that ``cell`` is done, or failed for ``reason``."""
        self.ended[cell.digest] = Outcome(None, reason, seconds, error)
        self.observer.finish(cell, cached=cached, reason=reason)
        self.tell()

    def fail(self, cell: Cell, reason: str, traceback: str, seconds: float, error: Exception | None = None) -> None:
        """Put down that ``cell`` failed, in the store, too."""
        self.store.fail(cell, reason=reason, traceback=traceback, seconds=seconds)
        self.end(cell, reason, seconds, error=error)

    def without(self, cell: Cell) -> set[str]:
        """Return the digests of the needed cells that a stored result did without: a tolerant cell's may be stale."""
        record = self.store.find(cell.digest) if cell.tolerant else None
        return set() if record is None else set(record.without)

    def seconds(self, cell: Cell) -> float:
        """Return how long ``cell`` took when it was computed or tried, as far as that is known."""
        record = self.store.find(cell.digest)
        return 0.0 if record is None else record.seconds

    def tell(self, *sentences: str) -> None:
        """Tell the observer these sentences and the store's remarks, each once."""
        for sentence in (*sentences, *self.store.remarks):
            if sentence not in self._told:
                self._told.add(sentence)
                self.observer.remark(sentence)


class Here:
    """Computes cells in this process and puts down in a ``ledger`` how they end."""

    def __init__(self, ledger: Ledger) -> None:
        self.ledger, self.store = ledger, ledger.store

    def to_the_end(self, cells: Sequence[Cell]) -> None:
        """Compute ``cells``, of which each stands after those it needs; wait for what other processes compute."""
        left = self.ledger.left(cells)
        while left:
            moved = [
                cell
                for cell in left
                if not self.ledger.waits(cell) and (self.ledger.decided(cell) or self.attempt(cell))
            ]
            left = self.ledger.left(left)
            if left and not moved:
                time.sleep(PATIENCE)

    def attempt(self, cell: Cell) -> bool:
        """Compute ``cell``, all of whose needs have ended, unless another process is at it; say whether it ended."""
        with self.store.claim(cell) as ours:
            if not ours:
                return False
            if not self.ledger.found(cell):  # by another process, while this one was busy
                self._compute(cell)
        return True

    def _compute(self, cell: Cell) -> None:
        ledger = self.ledger
        ledger.observer.start(cell)
        began = time.perf_counter()
        checkpoint = self.store.checkpoint(cell)
        progress = partial(ledger.observer.progress, cell)
        work = Work(self._result, progress, self.store.place(cell), checkpoint, self.store.where)
        try:
            with one_blas_thread():  # as in the processes that compute other cells
                value = cell.settings.compute(work)
        except Blocked as blocked:  # no failure of its own, so that none is stored
            ledger.end(cell, str(blocked), 0.0)
            return
        except Exception as error:  # whatever a plugin does, the other cells go on
            self._fail(cell, error, time.perf_counter() - began)
            return
        seconds = time.perf_counter() - began
        try:
            without = [needed for needed in cell.needs if ledger.ended[needed.digest].failed]
            self.store.keep(cell, value, seconds=seconds, without=without)
        except OSError:  # a full disk stops all cells
            raise
        except Exception as error:  # a plugin's result may be such that it cannot be written
            self._fail(cell, error, seconds)
            return
        checkpoint.unlink(missing_ok=True)
        ledger.end(cell, None, seconds)

    def _fail(self, cell: Cell, error: Exception, seconds: float) -> None:
        reason = str(error) if isinstance(error, SysidEvoError) else described(error)
        self.ledger.fail(cell, reason, traceback.format_exc(), seconds, error)

    def _result(self, cell: Cell) -> Any:
        """Return the value of a needed cell; one that turns out to be unreadable is computed again."""
        ended = self.ledger.ended
        if cell.digest not in ended:
            raise InvalidArgument(f"{cell.title} is not among the needs of the cell that asks for its result")
        if ended[cell.digest].failed:
            return None
        try:
            return self.store.load(cell)
        except ArtefactError as error:
            if self.ledger.only is not None and cell not in self.ledger.only:
                raise
            self.ledger.observer.remark(f"{error}: {cell.title} is computed again")
            self._compute(cell)
            reason = ended[cell.digest].reason
            if reason is not None:
                raise ArtefactError(f"needs {cell.title}, which failed: {reason}") from error
            return self.store.load(cell)
