"""Progress on standard error: which cell of how many, its rate, and the time left of all."""

from __future__ import annotations

import time
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self

from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.text import Text

from sysid_evo.cli.console import err, tell

if TYPE_CHECKING:
    from sysid_evo.plan import Cell

REPORT_EVERY = 10.0  # s, between lines where there is no terminal to draw on
SHORTEST = 20  # characters of a title


class Bars:
    """An `Observer` of an execution that draws two bars, or writes plain lines without a terminal.

    ``folder`` is the run folder with which an interrupted command goes on, if it can.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = folder
        self._bars = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=12),
            TextColumn("{task.fields[note]}", justify="right"),
            TimeElapsedColumn(),
            console=err,
            transient=True,
            disable=not err.is_terminal or err.quiet,
        )
        self._all: TaskID | None = None
        self._current: tuple[str, TaskID, float] | None = None
        self._cells = self._ended = 0
        self._expected: dict[str, float] = {}
        self._left = self._spent = self._foreseen = 0.0
        self._told = time.monotonic()

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bars.stop()
        if kind is not None and issubclass(kind, KeyboardInterrupt):
            what = "between two cells" if self._current is None else self._current[0]
            on = "" if self._folder is None else f"; go on with --out {self._folder}"
            tell(f"interrupted: {what}. Nothing unfinished is kept{on}")

    def plan(self, cells: int, kept: int, seconds: float) -> None:
        self._cells, self._left = cells, seconds
        if kept:
            tell(f"{kept} of {cells} cells are done already", label="kept ", style="dim")
        self._all = self._bars.add_task("all", total=cells, completed=0, note="")

    def start(self, cell: Cell) -> None:
        self.begin(cell.title)
        self._expected[cell.title] = cell.seconds()

    def begin(self, title: str) -> None:
        """A piece of work that is no cell of a plan begins."""
        self._current = (title, self._bars.add_task(_short(title), total=None, note=""), time.monotonic())

    def progress(self, cell: Cell, done: int, total: int) -> None:
        self.advance(done, total)

    def advance(self, done: int, total: int) -> None:
        """The present piece of work has done so many of its steps."""
        if self._current is None:
            return
        title, bar, began = self._current
        now = time.monotonic()
        rate = done / max(now - began, 1e-9)
        self._bars.update(bar, completed=done, total=total, note=f"{rate:,.1f}/s")
        if not err.is_terminal and now - self._told > REPORT_EVERY:
            self._told = now
            left = f", {rate:,.1f}/s, {(total - done) / rate:.0f} s left" if done else ""
            tell(f"{self._where()}{title}: {done}/{total}{left}")

    def finish(self, cell: Cell, *, cached: bool, reason: str | None) -> None:
        self._ended += 1
        if cell.title in self._expected:
            expected = self._expected.pop(cell.title)
            self._foreseen += expected
            self._left = max(0.0, self._left - expected)
            self._spent += self._passed()
        if not cached or reason is not None:
            self.end(cell.title, reason)
        if self._all is not None:
            pace = self._spent / self._foreseen if self._foreseen else 1.0
            note = f"{self._ended} of {self._cells}, {_duration(self._left * pace)} left"
            self._bars.update(self._all, completed=self._ended, note=note)

    def end(self, title: str, reason: str | None) -> None:
        """The present piece of work is done, or failed for ``reason``."""
        seconds = self._passed()
        if self._current is not None:
            self._bars.remove_task(self._current[1])
            self._current = None
        if reason is not None:
            err.print(Text.assemble(("failed", "red"), f" {title}: {reason}"))
        elif not err.is_terminal:
            tell(f"{self._where()}{title}, {seconds:.1f} s", label="done ", style="green")

    def remark(self, sentence: str) -> None:
        tell(sentence, label="note: ", style="dim")

    def _passed(self) -> float:
        return 0.0 if self._current is None else time.monotonic() - self._current[2]

    def _where(self) -> str:
        return f"{self._ended} of {self._cells}: " if self._cells else ""


def _duration(seconds: float) -> str:
    return f"{seconds / 60:.0f} min" if seconds >= 90 else f"{seconds:.0f} s"


def _short(title: str, width: int = 30) -> str:
    width = max(SHORTEST, min(width, err.width - 45))
    return title if len(title) <= width else title[: width - 1] + "…"
