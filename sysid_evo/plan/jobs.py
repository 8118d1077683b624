"""How many cells are computed side by side: as many as there are processors, work and memory for."""

from __future__ import annotations

import os
from collections.abc import Collection
from pathlib import Path

from sysid_evo.errors import InvalidArgument
from sysid_evo.plan.cell import Cell
from sysid_evo.processors import usable_processors

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
    asked = wanted or _by_default(sum(cell.seconds() for cell in left))
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
