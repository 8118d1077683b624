"""How the cells of a plan have ended so far, and what the user is told of it."""

from __future__ import annotations

from collections.abc import Collection

from sysid_evo.plan.cell import Cell
from sysid_evo.plan.plan import Plan
from sysid_evo.plan.store import Outcome, Store, blocked_by


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


class RunState:
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
        kept = [cell for cell in self.plan if self.store.done(cell) and not self.store.without(cell)]
        self.tell()
        known = set(kept)
        left = [cell for cell in self.plan if cell not in known]
        self.observer.plan(len(self.plan), len(kept), sum(cell.seconds for cell in left))
        for cell in kept:
            self.end(cell, None, self.store.seconds(cell), cached=True)
        return left

    def failed(self, cell: Cell) -> list[Cell]:
        """Return what ``cell`` needs and does without, as it failed."""
        return [needed for needed in cell.needs if self.ended[needed.digest].failed]

    def decided(self, cell: Cell) -> bool:
        """Whether ``cell``, which waits for nothing, ends without work: what it needs failed, or nobody wants it."""
        failed = self.failed(cell)
        if failed and not cell.tolerant:
            self.end(cell, blocked_by(failed[0]), 0.0)
            return True
        if self.only is not None and cell not in self.only:
            known = self.store.outcome(cell)
            self.end(cell, known.reason, known.seconds, cached=True)
            return True
        return False

    def end(
        self, cell: Cell, reason: str | None, seconds: float, *, cached: bool = False, error: Exception | None = None
    ) -> None:
        """Put down that ``cell`` is done, or failed for ``reason``."""
        self.ended[cell.digest] = Outcome(None, reason, seconds, error)
        self.observer.finish(cell, cached=cached, reason=reason)
        self.tell()

    def tell(self, *sentences: str) -> None:
        """Tell the observer these sentences and the store's remarks, each once."""
        for sentence in (*sentences, *self.store.remarks):
            if sentence not in self._told:
                self._told.add(sentence)
                self.observer.remark(sentence)
