"""Execution of a plan in this process, in worker processes, or on a cluster; other processes may share the work."""

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
from sysid_evo.plan.cell import Cell, Observer
from sysid_evo.plan.dask_executor import DaskExecutor, Scheduler
from sysid_evo.plan.plan import Plan, critical_path, local_cells
from sysid_evo.plan.processes import Processes
from sysid_evo.plan.run_cell import CellEnd, CellLost, Unsendable, run_cell
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
    """Compute the cells of ``plan`` that are not in ``store``; return the outcomes of all cells by digest.

    A failed cell is an outcome with a reason, and so is a cell whose needs failed; the other cells continue. A cell
    that another process has claimed is left to that process.

    - ``only``: compute these cells only; the outcomes of others are those in the store.
    - ``jobs``: number of worker processes; 1 computes in this process; None is one job per processor if there is
      enough work, see `number_of_jobs`.
    - ``scheduler``: compute on the workers of this Dask cluster instead (address, scheduler file or client).

    Results depend on neither. Raises OSError if a result cannot be written, `SchedulerLost` if the scheduler does not
    answer.
    """
    if scheduler is not None and jobs not in (None, 1):
        raise InvalidArgument(f"expected either jobs or a scheduler, got {jobs} jobs and a scheduler: omit one of them")
    execution = Execution(plan, store, observer, only)
    left = execution.left
    if scheduler is not None and left:
        check_installed("a scheduler", ["distributed"])
        with DaskExecutor(store, left, scheduler, execution.remark) as workers:
            execution.run(workers, local_cells(plan))
        return execution.ended
    count, sentence = number_of_jobs(jobs, left)
    if sentence:
        execution.remark(sentence)
    if count > 1:
        with Processes(store, left, count) as workers:
            execution.run(workers)
    else:
        execution.run()
    return execution.ended


PATIENCE = 0.1  # s, between two checks of cells that another process computes
POLL_INTERVAL = 0.2  # s, between two reports of the workers' progress
MAX_ATTEMPTS = 2
"""Number of attempts at a cell whose worker dies."""


class Workers(Protocol):
    """Workers of one or several `concurrent.futures.Executor`."""

    def n_idle(self) -> int:
        """Return the number of cells that can be sent now."""

    def submit(self, cell: Cell, failed: Collection[str]) -> Future[Any] | None:
        """Send ``cell``, see `run_cell`; None if it must wait. Raises `Unsendable`."""

    def result(self, cell: Cell, future: Future[Any]) -> CellEnd:
        """Return the end of ``cell``; its result is in the store. Raises `CellLost`, OSError."""

    def progress(self) -> Iterable[tuple[Cell, int, int, str]]:
        """Return the progress of cells: steps done, steps in total, and a note."""


class Execution:
    """Execution of the cells of a plan, in the order of their needs; cells on the critical path first.

    ``ended`` holds the outcomes by digest; cells whose results are stored end at once, the others are ``left``. With
    ``only``, other cells are not computed: their outcomes are those in the store.
    """

    def __init__(self, plan: Plan, store: Store, observer: Observer | None, only: Collection[Cell] | None) -> None:
        self.plan, self.store, self.observer, self.only = plan, store, observer or Observer(), only
        self.workers: Workers | None = None
        self.local: set[str] = set()
        self.ended: dict[str, CellOutcome] = {}
        self.reported: set[str] = set()
        self.started: set[str] = set()
        self.attempts: Counter[str] = Counter()
        self.rank: dict[str, tuple[float, int]] = {}
        self.ready: list[tuple[tuple[float, int], Cell]] = []  # for workers
        self.ready_here: list[tuple[tuple[float, int], Cell]] = []  # for this process
        self.busy: list[tuple[float, Cell]] = []  # cells that another process computes, and when to check again
        self.sent: dict[Future[Any], Cell] = {}
        self.last_progress = time.monotonic()
        kept = {cell for cell in plan if store.done(cell) and not store.without(cell)}
        self.remark()
        self.left = [cell for cell in plan if cell not in kept]
        self.observer.plan(len(plan), len(kept), sum(cell.expected_seconds for cell in self.left))
        for cell in plan:
            if cell in kept:
                self._end(cell, CellEnd("kept", store.seconds(cell)))
        self.open: Counter[str] = Counter()  # number of unfinished needs of each cell
        self.waiting: dict[str, list[Cell]] = {}  # cells by the digest of a need
        for cell in self.left:
            for digest in {needed.digest for needed in cell.needs} - set(self.ended):
                self.open[cell.digest] += 1
                self.waiting.setdefault(digest, []).append(cell)

    def run(self, workers: Workers | None = None, local: Collection[str] = ()) -> None:
        """Compute the cells that are left on ``workers``; this process computes the ``local`` digests.

        This process also computes cells that are unknown to the workers. Without workers it computes all, in the order
        of the plan. Raises OSError if a result cannot be written, and the errors of the workers.
        """
        self.workers, self.local = workers, set(local)
        ahead = {} if workers is None else critical_path(self.plan)
        self.rank = {cell.digest: (-ahead.get(cell.digest, 0.0), i) for i, cell in enumerate(self.plan)}
        self._schedule([cell for cell in self.left if not self.open[cell.digest]])
        try:
            self._work(workers)
        except KeyboardInterrupt:
            if workers is not None:
                self._show_progress(workers)  # the observer names what is interrupted, also what has just begun
            raise

    def _work(self, workers: Workers | None) -> None:
        while self.ready or self.ready_here or self.busy or self.sent:
            while self.busy and self.busy[0][0] <= time.monotonic():
                self._push(self.busy.pop(0)[1])
            while self.ready and workers is not None and workers.n_idle():
                self._send(heappop(self.ready)[1], workers)
            if self.ready_here:
                cell = heappop(self.ready_here)[1]
                self.started.add(cell.digest)
                end = run_cell(self.store, cell, self._failed(cell), self.observer, repair=self.only is None)
                self._finish(cell, end)
            if self.sent and workers is not None:
                self._collect(workers)
            elif not self.ready_here and (self.busy or self.ready):
                time.sleep(PATIENCE)

    def remark(self, *sentences: str) -> None:
        """Pass these sentences and the store's remarks to the observer, each once."""
        for sentence in (*sentences, *self.store.remarks):
            if sentence not in self.reported:
                self.reported.add(sentence)
                self.observer.remark(sentence)

    def _schedule(self, cells: list[Cell]) -> None:
        """Queue cells without unfinished needs, or end them and then the cells that depend on them."""
        while cells:
            cell = cells.pop()
            end = self._end_without_work(cell)
            if end is None:
                self._push(cell)
                continue
            self._end(cell, end)
            cells += self._released(cell)

    def _end_without_work(self, cell: Cell) -> CellEnd | None:
        """Return the end of a cell whose needs failed or that is not in ``only``; None if it must be computed."""
        failed = [needed for needed in cell.needs if self.ended[needed.digest].failed]
        if failed and not cell.tolerant:
            return CellEnd("blocked", reason=blocked_reason(failed[0]))
        if self.only is not None and cell not in self.only:
            known = self.store.outcome(cell)
            return CellEnd("kept", known.seconds, known.reason)
        return None

    def _released(self, ended: Cell) -> list[Cell]:
        """Return the cells whose last unfinished need was ``ended``."""
        waited = self.waiting.pop(ended.digest, [])
        for cell in waited:
            self.open[cell.digest] -= 1
        return [cell for cell in waited if not self.open[cell.digest]]

    def _push(self, cell: Cell) -> None:
        local = self.workers is None or cell.local or cell.digest in self.local
        heappush(self.ready_here if local else self.ready, (self.rank[cell.digest], cell))

    def _failed(self, cell: Cell) -> set[str]:
        return {needed.digest for needed in cell.needs if self.ended[needed.digest].failed}

    def _send(self, cell: Cell, workers: Workers) -> None:
        try:
            future = workers.submit(cell, self._failed(cell))
        except Unsendable as error:
            self._finish(cell, CellEnd("unknown", reason=str(error)))
        else:
            if future is None:
                self._finish(cell, CellEnd("busy"))
            else:
                self.sent[future] = cell

    def _collect(self, workers: Workers) -> None:
        """Collect finished cells, with a short wait if there are none, and report the workers' progress."""
        patience = 0.0 if self.ready_here else PATIENCE if self.busy else POLL_INTERVAL
        ended, _ = wait(self.sent, timeout=patience, return_when=FIRST_COMPLETED)
        for future in ended:
            cell = self.sent.pop(future)
            try:
                end = workers.result(cell, future)
            except CellLost as error:
                self._retry(cell, error)
            else:
                self._finish(cell, end)
        if time.monotonic() - self.last_progress >= POLL_INTERVAL:
            self._show_progress(workers)

    def _show_progress(self, workers: Workers) -> None:
        self.last_progress = time.monotonic()
        for cell, done, total, note in workers.progress():
            self._start(cell)
            self.observer.progress(cell, done, total, note)

    def _start(self, cell: Cell) -> None:
        if cell.digest not in self.started:
            self.started.add(cell.digest)
            self.observer.start(cell)

    def _retry(self, cell: Cell, error: CellLost) -> None:
        """Try a lost cell again; after `MAX_ATTEMPTS` attempts it has failed."""
        self.attempts[cell.digest] += 1
        if self.attempts[cell.digest] < MAX_ATTEMPTS:
            self.remark(f"{cell.title} is computed again: {error}")
            self._push(cell)
            return
        reason = f"{error}, {MAX_ATTEMPTS} times"
        self.store.fail(cell, reason=reason, traceback="", seconds=0.0)
        self._finish(cell, CellEnd("failed", reason=reason))

    def _finish(self, cell: Cell, end: CellEnd) -> None:
        """Process the end of an attempt at ``cell``, with its remarks and warnings."""
        for sentence in end.warnings:
            warnings.warn(sentence, stacklevel=2)
        self.remark(*end.remarks)
        if end.status == "busy":
            self.busy.append((time.monotonic() + PATIENCE, cell))
        elif end.status == "unknown":
            self.local.add(cell.digest)
            self.remark(f"cells that workers cannot run are computed in this process ({end.reason})")
            self._push(cell)
        else:
            if end.status in ("done", "failed"):
                self._start(cell)
            self._end(cell, end)
            self._schedule(self._released(cell))

    def _end(self, cell: Cell, end: CellEnd) -> None:
        self.ended[cell.digest] = CellOutcome(None, end.reason, end.seconds, end.error)
        self.observer.finish(cell, cached=end.status == "kept", reason=end.reason)
        self.remark()


VARIABLE = "SYSID_EVO_JOBS"
"""Environment variable with the default number of jobs."""
SECONDS_PER_PROCESS = 5.0
"""Seconds of work per process: with less work, starting another process does not pay."""
MEMORY = 2**30
"""Bytes that one process may need; most of it is library code."""
LIMITS = tuple(Path("/sys/fs/cgroup") / name for name in ("memory.max", "memory.current"))
"""Memory limit and memory use of a container."""


def number_of_jobs(wanted: int | None, left: Collection[Cell]) -> tuple[int, str]:
    """Return the number of jobs for the cells that are ``left``, and the reason if it is less than ``wanted``.

    ``wanted`` None is one job per processor, limited by the amount of work. Raises `InvalidArgument`.
    """
    if wanted is not None and wanted < 1:
        raise InvalidArgument(f"jobs: expected at least 1, got {wanted}")
    requested = wanted or _by_default(sum(cell.expected_seconds for cell in left))
    jobs = max(1, min(requested, len(left)))
    if jobs == 1:
        return 1, ""
    available = available_memory()
    fitting = max(1, available // MEMORY)
    if fitting >= jobs:
        return jobs, ""
    return fitting, (
        f"{fitting} instead of {jobs} cells are computed at the same time: {available / 2**30:.1f} GiB of memory are "
        f"free, and each may need {MEMORY / 2**30:.0f} GiB"
    )


def _by_default(seconds: float) -> int:
    text = os.environ.get(VARIABLE, "")
    if not text:
        return min(usable_processors(), int(seconds / SECONDS_PER_PROCESS))
    if not text.isdecimal() or int(text) < 1:
        raise InvalidArgument(f"{VARIABLE}: expected a number of jobs, at least 1, got {text!r}")
    return int(text)


def available_memory() -> int:
    """Return the bytes of free memory without swap, within the limits of a container."""
    import psutil

    free = int(psutil.virtual_memory().available)
    try:
        limit, used = (file.read_text(encoding="ascii").strip() for file in LIMITS)
    except OSError:  # no such system, or no container
        return free
    return free if limit == "max" else min(free, max(0, int(limit) - int(used)))
