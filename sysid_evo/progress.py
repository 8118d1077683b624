"""Progress reports and checkpoints of long work, through callables, so that libraries never print or write."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import TYPE_CHECKING, Protocol, TypeAlias

from sysid_evo.errors import printable

if TYPE_CHECKING:
    from sysid_evo.types import Array


class Progress(Protocol):
    """Called from time to time with the number of steps done and in total, and a ``note`` for the display.

    An exception that it raises stops the work and leaves its object as before.
    """

    def __call__(self, done: int, total: int, note: str = "") -> None: ...


class Counter:
    """Counts ``total`` parts of long work and reports to a `Progress`, if there is one."""

    def __init__(self, progress: Progress | None, total: int) -> None:
        self.progress = progress
        self.total = total
        self.done = 0

    def advance(self, parts: int = 1) -> None:
        """Report that ``parts`` more are done; 0 only shows that the work continues."""
        self.done += parts
        if self.progress is not None:
            self.progress(self.done, self.total)


REPORTED_SECONDS = 600.0
"""A fit that is estimated to take longer than this (s) is reported."""
MIN_SECONDS = 5.0
"""Processor time (s) before the remaining time is estimated; wall time would depend on the load of the machine."""


class TimeLeft:
    """Estimates the remaining time of work from the times at which its parts were finished."""

    def __init__(self) -> None:
        self.first: tuple[float, int] | None = None
        self.reported = False

    def long(self, done: int, total: int) -> float | None:
        """Return the remaining time (s), once, as soon as the estimate exceeds `REPORTED_SECONDS`; else None."""
        now = time.process_time()
        if self.first is None:  # the first part is not counted, because it includes work done once, such as compiling
            self.first = (now, done) if done > 0 else None
        elif done > self.first[1] and now - self.first[0] > MIN_SECONDS and not self.reported:
            left = (now - self.first[0]) / (done - self.first[1]) * (total - done)
            self.reported = left > REPORTED_SECONDS
            return left if self.reported else None
        return None


def reporting(progress: Progress | bool | None, title: str) -> AbstractContextManager[Progress | None]:
    """Return a context with the receiver of progress reports: a progress bar for True, None for False."""
    return progress_bar(title) if progress is True else nullcontext(progress or None)


@contextmanager
def progress_bar(title: str) -> Iterator[Progress]:
    """Draw a progress bar with rate and time left on standard error.

    If that is not a terminal, as in a notebook or a file, print a line every few seconds.
    """
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as Bars

    if not sys.stderr.isatty():  # rich takes a Jupyter kernel for a terminal
        yield _lines(title)
        return
    described = TextColumn("{task.description}", markup=False)
    columns = (described, BarColumn(bar_width=24), TextColumn("{task.percentage:>3.0f} %"))
    with Bars(*columns, TimeElapsedColumn(), TimeRemainingColumn(), console=Console(stderr=True)) as bars:
        task = bars.add_task(printable(title), total=None)

        def update(done: int, total: int, note: str = "") -> None:
            described = printable(f"{title}: {note}" if note else title)
            bars.update(task, completed=done, total=total, description=described)

        yield update


LINE_INTERVAL = 5.0
"""Seconds between two lines without a progress bar."""


def _lines(title: str) -> Progress:
    """Return a progress receiver that writes a line from time to time, and one at the end."""
    last = time.monotonic()

    def update(done: int, total: int, note: str = "") -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= LINE_INTERVAL or done == total:
            last = now
            sys.stderr.write(printable(f"{title}: {done} of {total}{f', {note}' if note else ''}") + "\n")
            sys.stderr.flush()

    return update


CheckpointState: TypeAlias = "Mapping[str, Array | int | float | str]"
"""The state from which work resumes, by name: float64 arrays, numbers and text."""


class Checkpoint(Protocol):
    """Keeps the last state of long work; `sysid_evo.artefacts.CheckpointFile` keeps it in a file."""

    def load(self, identity: str) -> CheckpointState | None:
        """Return the state saved with this ``identity``, or None."""
        ...

    def due(self) -> bool:
        """Whether it is time to save again; results never depend on it."""
        ...

    def save(self, identity: str, state: CheckpointState) -> None:
        """Replace the saved state by ``state``."""
        ...
