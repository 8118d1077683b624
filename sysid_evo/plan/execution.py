"""Computes the cells of a plan, here, one after the other; other processes may work on the same folder."""

from __future__ import annotations

import time
import traceback
from collections.abc import Collection
from functools import partial
from typing import Any, Protocol

from sysid_evo.errors import ArtefactError, Blocked, InvalidArgument, SysidEvoError
from sysid_evo.plan.cell import Cell, Work
from sysid_evo.plan.plan import Plan
from sysid_evo.plan.store import Outcome, Store, blocked_by

PATIENCE = 0.1  # s between two looks at cells that another process computes


class Observer(Protocol):
    """Is told what an execution is doing; the command line draws progress from it."""

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


class Silent:
    """An observer that does nothing."""

    def plan(self, cells: int, kept: int, seconds: float) -> None:
        pass

    def start(self, cell: Cell) -> None:
        pass

    def progress(self, cell: Cell, done: int, total: int, note: str = "") -> None:
        pass

    def finish(self, cell: Cell, *, cached: bool, reason: str | None) -> None:
        pass

    def remark(self, sentence: str) -> None:
        pass


def execute(
    plan: Plan, store: Store, *, observer: Observer | None = None, only: Collection[Cell] | None = None
) -> dict[str, Outcome]:
    """Compute every cell of ``plan`` that ``store`` does not have; return how each ended, by digest.

    A cell that fails is an outcome with its reason, and so is one whose needs failed; the rest goes on.
    A cell that another process has claimed is left to it. With ``only``, no others are computed: what
    they gave is what the store knows. Raises OSError if a result cannot be written.
    """
    return _Execution(plan, store, observer or Silent(), only).run()


class _Execution:
    def __init__(self, plan: Plan, store: Store, observer: Observer, only: Collection[Cell] | None) -> None:
        self.plan, self.store, self.observer, self.only = plan, store, observer, only
        self.ended: dict[str, Outcome] = {}
        self.told: set[str] = set()

    def run(self) -> dict[str, Outcome]:
        kept = [cell for cell in self.plan if self.store.done(cell) and not self._without(cell)]
        self._remarks()
        known = set(kept)
        left = [cell for cell in self.plan if cell not in known]
        self.observer.plan(len(self.plan), len(kept), sum(cell.seconds() for cell in left))
        for cell in kept:
            self._end(cell, None, self._seconds(cell), cached=True)
        while left:
            moved = [cell for cell in left if self._settle(cell)]
            left = [cell for cell in left if cell.digest not in self.ended]
            if left and not moved:
                time.sleep(PATIENCE)
        return self.ended

    def _settle(self, cell: Cell) -> bool:
        """Bring one cell to its end if nothing stands in the way; say whether it is there."""
        if any(needed.digest not in self.ended for needed in cell.needs):
            return False
        failed = [needed for needed in cell.needs if self.ended[needed.digest].failed]
        if failed and not cell.tolerant:
            self._end(cell, blocked_by(failed[0]), 0.0)
            return True
        if self.only is not None and cell not in self.only:
            known = self.store.outcome(cell)
            self._end(cell, known.reason, known.seconds, cached=True)
            return True
        with self.store.claim(cell) as ours:
            if not ours:
                return False
            if self.store.done(cell) and self._without(cell) == {needed.digest for needed in failed}:
                # by another process, while this one was busy
                self._end(cell, None, self._seconds(cell), cached=True)
            else:
                self._compute(cell)
        return True

    def _compute(self, cell: Cell) -> None:
        self.observer.start(cell)
        began = time.perf_counter()
        checkpoint = self.store.checkpoint(cell)
        work = Work(
            self._result, partial(self.observer.progress, cell), self.store.place(cell), checkpoint, self.store.where
        )
        try:
            value = cell.compute(work)
        except Blocked as blocked:  # no failure of its own, so that none is stored
            self._end(cell, str(blocked), 0.0)
            return
        except Exception as error:  # whatever a plugin does, the other cells go on
            self._fail(cell, error, time.perf_counter() - began)
            return
        seconds = time.perf_counter() - began
        try:
            without = [needed for needed in cell.needs if self.ended[needed.digest].failed]
            self.store.keep(cell, value, seconds=seconds, without=without)
        except OSError:  # a full disk stops all cells
            raise
        except Exception as error:  # a plugin's result may be such that it cannot be written
            self._fail(cell, error, seconds)
            return
        checkpoint.unlink(missing_ok=True)
        self._end(cell, None, seconds)

    def _fail(self, cell: Cell, error: Exception, seconds: float) -> None:
        reason = str(error) if isinstance(error, SysidEvoError) else f"{type(error).__name__}: {error}"
        self.store.fail(cell, reason=reason, traceback=traceback.format_exc(), seconds=seconds)
        self._end(cell, reason, seconds, error=error)

    def _without(self, cell: Cell) -> set[str]:
        """Return the digests of the needed cells that a stored result did without: a tolerant cell's may be stale."""
        record = self.store.find(cell.digest) if cell.tolerant else None
        return set() if record is None else set(record.without)

    def _result(self, cell: Cell) -> Any:
        """Return the value of a needed cell; one that turns out to be unreadable is computed again."""
        if cell.digest not in self.ended:
            raise InvalidArgument(f"{cell.title} is not among the needs of the cell that asks for its result")
        if self.ended[cell.digest].failed:
            return None
        try:
            return self.store.load(cell)
        except ArtefactError as error:
            if self.only is not None and cell not in self.only:
                raise
            self.observer.remark(f"{error}: {cell.title} is computed again")
            self._compute(cell)
            ended = self.ended[cell.digest]
            if ended.reason is not None:
                raise ArtefactError(f"needs {cell.title}, which failed: {ended.reason}") from error
            return self.store.load(cell)

    def _end(
        self, cell: Cell, reason: str | None, seconds: float, *, cached: bool = False, error: Exception | None = None
    ) -> None:
        self.ended[cell.digest] = Outcome(None, reason, seconds, error)
        self.observer.finish(cell, cached=cached, reason=reason)
        self._remarks()

    def _seconds(self, cell: Cell) -> float:
        record = self.store.find(cell.digest)
        return 0.0 if record is None else record.seconds

    def _remarks(self) -> None:
        for sentence in self.store.remarks:
            if sentence not in self.told:
                self.told.add(sentence)
                self.observer.remark(sentence)
