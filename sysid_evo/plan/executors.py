"""A plan computed: in this process, in several beside it, or on a cluster; other processes may work on it, too."""

from __future__ import annotations

import os
import time
import warnings
from collections import Counter
from collections.abc import Collection, Iterable
from concurrent.futures import FIRST_COMPLETED, Future, wait
from heapq import heappop, heappush
from pathlib import Path
from typing import Any, Protocol

from sysid_evo.errors import InvalidArgument
from sysid_evo.extras import check_installed
from sysid_evo.plan.cell import Cell
from sysid_evo.plan.dask_executor import DaskExecutor, Scheduler
from sysid_evo.plan.plan import Plan, critical_path, local_cells
from sysid_evo.plan.processes import Processes
from sysid_evo.plan.run_cell import CellEnd, CellLost, Observer, Unsendable, run_cell
from sysid_evo.plan.store import CellOutcome, Store, blocked_reason
from sysid_evo.processors import usable_processors


def execute(
    plan: Plan,
    store: Store,
    *,
    observer: Observer | None = None,
    only: Collection[Cell] | None = None,
    jobs: int | None = 1,
    scheduler: Scheduler | None = None,
) -> dict[str, CellOutcome]:
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
    if scheduler is not None and jobs not in (None, 1):
        raise InvalidArgument(f"{jobs} jobs in processes here and a scheduler: expected one of both; leave one out")
    execution = Execution(plan, store, observer, only)
    left = execution.left
    if scheduler is not None and left:
        check_installed("a scheduler", ["distributed"])
        with DaskExecutor(store, left, scheduler, execution.tell) as workers:
            execution.to_the_end(workers, local_cells(plan))
        return execution.ended
    count, sentence = number_of_jobs(jobs, left)
    if sentence:
        execution.tell(sentence)
    if count > 1:
        with Processes(store, left, count) as workers:
            execution.to_the_end(workers)
    else:
        execution.to_the_end()
    return execution.ended


PATIENCE = 0.1  # s, between two looks at cells that another process computes
LOOK = 0.2  # s, between two looks at how far workers are
TRIES = 2
"""How often a cell is tried whose worker dies."""


class Workers(Protocol):
    """Workers behind one or several `concurrent.futures.Executor`."""

    def room(self) -> int:
        """Return how many more cells they can take."""

    def submit(self, cell: Cell, failed: Collection[str]) -> Future[Any] | None:
        """Send ``cell``, see `run_cell`; None if it must wait. Raises `Unsendable`."""

    def result(self, cell: Cell, future: Future[Any]) -> CellEnd:
        """Return how ``cell`` ended; its result is in the store. Raises `CellLost`, OSError."""

    def progress(self) -> Iterable[tuple[Cell, int, int, str]]:
        """Return how far cells are: steps done, steps in all, and what else there is to say."""


class Execution:
    """Brings the cells of a plan to their end: those whose needs are there, first what most work waits for.

    ``ended`` is how they ended, by digest; those whose results are there have ended at once, the others are ``left``.
    With ``only``, no others are computed: what they gave is what the store knows.
    """

    def __init__(self, plan: Plan, store: Store, observer: Observer | None, only: Collection[Cell] | None) -> None:
        self.plan, self.store, self.observer, self.only = plan, store, observer or Observer(), only
        self.workers: Workers | None = None
        self.here: set[str] = set()
        self.ended: dict[str, CellOutcome] = {}
        self.told: set[str] = set()
        self.started: set[str] = set()
        self.tried: Counter[str] = Counter()
        self.rank: dict[str, tuple[float, int]] = {}
        self.ready: list[tuple[tuple[float, int], Cell]] = []  # for workers
        self.own: list[tuple[tuple[float, int], Cell]] = []  # for this process
        self.later: list[tuple[float, Cell]] = []  # what another process computes, and when to look again
        self.away: dict[Future[Any], Cell] = {}
        self.looked = 0.0
        kept = {cell for cell in plan if store.done(cell) and not store.without(cell)}
        self.tell()
        self.left = [cell for cell in plan if cell not in kept]
        self.observer.plan(len(plan), len(kept), sum(cell.expected_seconds for cell in self.left))
        for cell in plan:
            if cell in kept:
                self._end(cell, CellEnd("kept", store.seconds(cell)))
        self.open: Counter[str] = Counter()  # how many cells each waits for
        self.waiting: dict[str, list[Cell]] = {}  # by what they wait for
        for cell in self.left:
            for digest in {needed.digest for needed in cell.needs} - set(self.ended):
                self.open[cell.digest] += 1
                self.waiting.setdefault(digest, []).append(cell)

    def to_the_end(self, workers: Workers | None = None, here: Collection[str] = ()) -> None:
        """Compute what is left: workers do, and this process what is ``here`` by its digest, or unknown to them.

        Without workers this process computes all, in the order of the plan. Raises OSError if a result cannot be
        written, and what the workers raise if they are lost.
        """
        self.workers, self.here = workers, set(here)
        ahead = {} if workers is None else critical_path(self.plan)
        self.rank = {cell.digest: (-ahead.get(cell.digest, 0.0), i) for i, cell in enumerate(self.plan)}
        self._free([cell for cell in self.left if not self.open[cell.digest]])
        while self.ready or self.own or self.later or self.away:
            while self.later and self.later[0][0] <= time.monotonic():
                self._push(self.later.pop(0)[1])
            while self.ready and workers is not None and workers.room():
                self._send(heappop(self.ready)[1], workers)
            if self.own:
                self._compute(heappop(self.own)[1])
            if self.away and workers is not None:
                self._take_in(workers)
            elif not self.own and (self.later or self.ready):
                time.sleep(PATIENCE)

    def tell(self, *sentences: str) -> None:
        """Tell the observer these sentences and the store's remarks, each once."""
        for sentence in (*sentences, *self.store.remarks):
            if sentence not in self.told:
                self.told.add(sentence)
                self.observer.remark(sentence)

    def _free(self, cells: list[Cell]) -> None:
        """Have cells computed that wait for nothing, or end them, and then what waited for them."""
        while cells:
            cell = cells.pop()
            end = self._decided(cell)
            if end is None:
                self._push(cell)
                continue
            self._end(cell, end)
            cells += self._released(cell)

    def _decided(self, cell: Cell) -> CellEnd | None:
        """Return how ``cell`` ends without work: what it needs failed, or it is not asked for; else None."""
        failed = [needed for needed in cell.needs if self.ended[needed.digest].failed]
        if failed and not cell.tolerant:
            return CellEnd("blocked", reason=blocked_reason(failed[0]))
        if self.only is not None and cell not in self.only:
            known = self.store.outcome(cell)
            return CellEnd("kept", known.seconds, known.reason)
        return None

    def _released(self, ended: Cell) -> list[Cell]:
        """Return the cells that waited for ``ended`` alone."""
        waited = self.waiting.pop(ended.digest, [])
        for cell in waited:
            self.open[cell.digest] -= 1
        return [cell for cell in waited if not self.open[cell.digest]]

    def _push(self, cell: Cell) -> None:
        here = self.workers is None or cell.local or cell.digest in self.here
        heappush(self.own if here else self.ready, (self.rank[cell.digest], cell))

    def _failed(self, cell: Cell) -> set[str]:
        return {needed.digest for needed in cell.needs if self.ended[needed.digest].failed}

    def _compute(self, cell: Cell) -> None:
        self.started.add(cell.digest)
        end = run_cell(self.store, cell, self._failed(cell), self.observer, repair=self.only is None)
        self._over(cell, end)

    def _send(self, cell: Cell, workers: Workers) -> None:
        try:
            future = workers.submit(cell, self._failed(cell))
        except Unsendable as error:
            self._over(cell, CellEnd("unknown", reason=str(error)))
        else:
            if future is None:
                self._over(cell, CellEnd("busy"))
            else:
                self.away[future] = cell

    def _take_in(self, workers: Workers) -> None:
        """Take in what workers have finished, wait a little if there is nothing, and pass on how far they are."""
        patience = 0.0 if self.own else PATIENCE if self.later else LOOK
        ended, _ = wait(self.away, timeout=patience, return_when=FIRST_COMPLETED)
        for future in ended:
            cell = self.away.pop(future)
            try:
                end = workers.result(cell, future)
            except CellLost as lost:
                self._again(cell, lost)
            else:
                self._over(cell, end)
        if time.monotonic() - self.looked >= LOOK:
            self.looked = time.monotonic()
            for cell, done, total, note in workers.progress():
                self._start(cell)
                self.observer.progress(cell, done, total, note)

    def _start(self, cell: Cell) -> None:
        if cell.digest not in self.started:
            self.started.add(cell.digest)
            self.observer.start(cell)

    def _again(self, cell: Cell, lost: CellLost) -> None:
        """Try a cell that was lost once more; then it has failed."""
        self.tried[cell.digest] += 1
        if self.tried[cell.digest] < TRIES:
            self.tell(f"{cell.title} is computed again: {lost}")
            self._push(cell)
            return
        reason = f"{lost}, {TRIES} times"
        self.store.fail(cell, reason=reason, traceback="", seconds=0.0)
        self._over(cell, CellEnd("failed", reason=reason))

    def _over(self, cell: Cell, end: CellEnd) -> None:
        """Take note of how an attempt at ``cell`` ended, and pass on what was said meanwhile."""
        for sentence in end.warnings:
            warnings.warn(sentence, stacklevel=2)
        self.tell(*end.remarks)
        if end.status == "busy":
            self.later.append((time.monotonic() + PATIENCE, cell))
        elif end.status == "unknown":
            self.here.add(cell.digest)
            self.tell(f"what workers do not know is computed in this process ({end.reason})")
            self._push(cell)
        else:
            if end.status in ("done", "failed"):
                self._start(cell)
            self._end(cell, end)
            self._free(self._released(cell))

    def _end(self, cell: Cell, end: CellEnd) -> None:
        self.ended[cell.digest] = CellOutcome(None, end.reason, end.seconds, end.error)
        self.observer.finish(cell, cached=end.status == "kept", reason=end.reason)
        self.tell()


VARIABLE = "SYSID_EVO_JOBS"
"""The environment variable with the number of jobs where none is asked for."""
WORTH = 5.0
"""Seconds of work for which one more process is worth its start."""
MEMORY = 2**30
"""Bytes that one process may need: most is the code of the libraries; cells take far less."""
LIMITS = tuple(Path("/sys/fs/cgroup") / name for name in ("memory.max", "memory.current"))
"""What a container may use in all, and what it does use."""


def number_of_jobs(wanted: int | None, left: Collection[Cell]) -> tuple[int, str]:
    """Return how many of the cells that are ``left`` to compute at once, and why fewer than ``wanted``, if so.

    None stands for as many as there are processors, but no more than there is work for. Raises `InvalidArgument`.
    """
    if wanted is not None and wanted < 1:
        raise InvalidArgument(f"jobs: expected at least 1, got {wanted}")
    asked = wanted or _by_default(sum(cell.expected_seconds for cell in left))
    jobs = max(1, min(asked, len(left)))
    if jobs == 1:
        return 1, ""
    available = available_memory()
    fitting = max(1, available // MEMORY)
    if fitting >= jobs:
        return jobs, ""
    return fitting, (
        f"{fitting} instead of {jobs} cells are computed at once: {available / 2**30:.1f} GiB of memory are free, "
        f"and each may need {MEMORY / 2**30:.0f}"
    )


def _by_default(seconds: float) -> int:
    text = os.environ.get(VARIABLE, "")
    if not text:
        return min(usable_processors(), int(seconds / WORTH))
    if not text.isdecimal() or int(text) < 1:
        raise InvalidArgument(f"{VARIABLE}: expected a number of jobs, at least 1, got {text!r}")
    return int(text)


def available_memory() -> int:
    """Return how many bytes can be used without swapping, within the limits of a container."""
    import psutil

    free = int(psutil.virtual_memory().available)
    try:
        limit, used = (file.read_text(encoding="ascii").strip() for file in LIMITS)
    except OSError:  # no such system, or no container
        return free
    return free if limit == "max" else min(free, max(0, int(limit) - int(used)))
