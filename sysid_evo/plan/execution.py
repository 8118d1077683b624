"""Computes the cells of a plan, in this process or side by side; other processes may work on the same folder."""

from __future__ import annotations

import time
import traceback
from collections.abc import Collection, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from sysid_evo.errors import ArtefactError, Blocked, InvalidArgument, SysidEvoError
from sysid_evo.extras import check_installed
from sysid_evo.plan.cell import Cell, Work
from sysid_evo.plan.ledger import Ledger, Observer
from sysid_evo.plan.plan import Plan
from sysid_evo.plan.store import Outcome, Store

if TYPE_CHECKING:
    from sysid_evo.plan.scheduler import Scheduler

PATIENCE = 0.1  # s between two looks at cells that another process computes


def execute(
    plan: Plan,
    store: Store,
    *,
    observer: Observer | None = None,
    only: Collection[Cell] | None = None,
    jobs: int | None = 1,
    scheduler: Scheduler | None = None,
) -> dict[str, Outcome]:
    """Compute every cell of ``plan`` that ``store`` does not have; return how each ended, by digest.

    A cell that fails is an outcome with its reason, and so is one whose needs failed; the rest goes on.
    A cell that another process has claimed is left to it. With ``only``, no others are computed: what
    they gave is what the store knows.

    Up to ``jobs`` cells that do not depend on each other are computed side by side, each in a process of its own; 1
    computes them here, one after the other; None as many as there are processors, where there is work for them, see
    `number_of_jobs`. With a ``scheduler`` the workers of that Dask cluster compute them instead: its address, its
    file, or a client. Results do not depend on it. Raises OSError if a result cannot be written, `SchedulerLost`
    if the scheduler does not answer.
    """
    from sysid_evo.plan.jobs import number_of_jobs

    if scheduler is not None and jobs not in (None, 1):
        raise InvalidArgument(f"{jobs} jobs in processes here and a scheduler: expected one of both; leave one out")
    ledger = Ledger(plan, store, observer, only)
    left = ledger.open()
    if scheduler is not None and plan.again is not None and left:
        check_installed("a scheduler", ["distributed"])
        from sysid_evo.plan.cluster import Cluster

        Cluster(ledger, plan.again, scheduler).to_the_end(left)
        return ledger.ended
    count, sentence = number_of_jobs(jobs, left)
    if sentence:
        ledger.tell(sentence)
    if count > 1 and plan.again is not None:
        from sysid_evo.plan.side_by_side import SideBySide

        SideBySide(ledger, plan.again, count).to_the_end(left)
    else:
        Here(ledger).to_the_end(left)
    return ledger.ended


class Here:
    """Computes cells in this process and puts down in a ``ledger`` how they end."""

    def __init__(self, ledger: Ledger) -> None:
        self.ledger, self.store = ledger, ledger.store

    def to_the_end(self, cells: Sequence[Cell]) -> None:
        """Compute ``cells``, of which each stands after those it needs; wait for what other processes compute."""
        left = self.ledger.left(cells)
        while left:
            moved = [cell for cell in left if self._settle(cell)]
            left = self.ledger.left(left)
            if left and not moved:
                time.sleep(PATIENCE)

    def _settle(self, cell: Cell) -> bool:
        """Bring one cell to its end if nothing stands in the way; say whether it is there."""
        if self.ledger.waits(cell):
            return False
        return self.ledger.decided(cell) or self.attempt(cell)

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
            value = cell.compute(work)
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
        reason = str(error) if isinstance(error, SysidEvoError) else f"{type(error).__name__}: {error}"
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
