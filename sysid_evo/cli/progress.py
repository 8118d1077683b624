"""Progress bars on standard error, with rate and time left, one line for each cell of a run."""

from __future__ import annotations

import time
from pathlib import Path
from types import TracebackType
from typing import Self

from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.text import Text

from sysid_evo.cli.console import err

REPORT_EVERY = 10.0  # s, between lines where there is no terminal to draw on


class Bars:
    """An `Observer` (see `sysid_evo.experiment`) that draws bars, or writes plain lines without a terminal.

    ``folder`` is the run folder with which an interrupted command goes on, if it can.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = folder
        self._bars = Progress(
            TextColumn("{task.description}", table_column=None),
            BarColumn(bar_width=16),
            TextColumn("{task.fields[rate]}", justify="right"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=err,
            disable=not err.is_terminal,
        )
        self._tasks: dict[str, TaskID] = {}
        self._began: dict[str, float] = {}
        self._told: dict[str, float] = {}

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bars.stop()
        if kind is not None and issubclass(kind, KeyboardInterrupt):
            cells = ", ".join(self._tasks) or "between two cells"
            on = "" if self._folder is None else f"; go on with --out {self._folder}"
            err.print(
                f"interrupted: {cells}. Nothing unfinished is kept{on}", highlight=False, markup=False, soft_wrap=True
            )

    def start(self, cell: str) -> None:
        self._began[cell] = self._told[cell] = time.monotonic()
        self._tasks[cell] = self._bars.add_task(_short(cell), total=None, rate="")

    def progress(self, cell: str, done: int, total: int) -> None:
        now = time.monotonic()
        rate = done / max(now - self._began[cell], 1e-9)
        self._bars.update(self._tasks[cell], completed=done, total=total, rate=f"{rate:,.1f}/s")
        if not err.is_terminal and now - self._told[cell] > REPORT_EVERY:
            self._told[cell] = now
            left = f", {rate:,.1f}/s, {(total - done) / rate:.0f} s left" if done else ""
            err.print(f"{cell}: {done}/{total}{left}", highlight=False, markup=False)

    def finish(self, cell: str, *, cached: bool, reason: str | None) -> None:
        seconds = time.monotonic() - self._began.get(cell, time.monotonic())
        if cell in self._tasks:
            self._bars.remove_task(self._tasks.pop(cell))
        if reason is not None:
            err.print(Text.assemble(("failed", "red"), f" {seconds:6.1f} s  {cell}: {reason}"))
        else:
            word = ("kept  ", "dim") if cached else ("done  ", "green")
            err.print(Text.assemble(word, f" {seconds:6.1f} s  {cell}"))


def _short(cell: str, width: int = 34) -> str:
    return cell if len(cell) <= width else cell[: width - 1] + "…"
