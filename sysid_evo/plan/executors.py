"""A plan computed: in this process, in several side by side, or on a cluster; other processes may work on it, too."""

from __future__ import annotations

import os
from collections.abc import Collection
from pathlib import Path

from sysid_evo.errors import InvalidArgument
from sysid_evo.extras import check_installed
from sysid_evo.plan.cell import Cell
from sysid_evo.plan.dask_executor import Cluster, Scheduler
from sysid_evo.plan.plan import Plan
from sysid_evo.plan.processes import SideBySide
from sysid_evo.plan.run_state import Here, Ledger, Observer
from sysid_evo.plan.store import Outcome, Store
from sysid_evo.processors import usable_processors


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
    if scheduler is not None and jobs not in (None, 1):
        raise InvalidArgument(f"{jobs} jobs in processes here and a scheduler: expected one of both; leave one out")
    ledger = Ledger(plan, store, observer, only)
    left = ledger.open()
    if scheduler is not None and plan.again is not None and left:
        check_installed("a scheduler", ["distributed"])
        Cluster(ledger, plan.again, scheduler).to_the_end(left)
        return ledger.ended
    count, sentence = number_of_jobs(jobs, left)
    if sentence:
        ledger.tell(sentence)
    if count > 1 and plan.again is not None:
        SideBySide(ledger, plan.again, count).to_the_end(left)
    else:
        Here(ledger).to_the_end(left)
    return ledger.ended


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
    asked = wanted or _by_default(sum(cell.seconds for cell in left))
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
