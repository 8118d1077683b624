"""Execution and listing of a plan on a terminal: bars, rates, time left."""

from __future__ import annotations

import shlex
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from types import TracebackType
from typing import TYPE_CHECKING, Self

from rich.console import Console, RenderableType
from rich.progress import BarColumn, Progress, ProgressColumn, TaskID, TextColumn, TimeElapsedColumn
from rich.text import Text

import sysid_evo.plan
from sysid_evo.cli.console import err, note, out, print_status, problems, session, table_of
from sysid_evo.plan.cell import Observer

if TYPE_CHECKING:
    from sysid_evo.plan import Cell, Plan, Store

REPORT_EVERY = 10.0  # s, between lines where there is no terminal to draw on
SHORTEST = 20  # characters of a title
SHOWN = 10
"""Cells that have a bar of their own at the same time: a cluster may run hundreds."""
MIN_DONE_SHARE = 0.1
"""Share of the work after which the time left is shown: the first steps compile kernels, or are quick."""
NAMED = 4
"""Cells that an interruption names."""


def run_plan(
    plan: Plan, store: Store, *, dry_run: bool, as_json: bool, jobs: int | None = None, scheduler: str | None = None
) -> Mapping[str, sysid_evo.plan.CellOutcome] | None:
    """Compute the missing cells of a plan and return the outcome of each cell by its digest.

    With ``dry_run`` print the plan instead and return None.
    """
    if dry_run:
        print_plan(plan, store, as_json=as_json)
        return None
    session.run = store
    with PlanProgress(f"--run {shlex.quote(str(store.path))}", cells=plan, elsewhere=scheduler is not None) as bars:
        return sysid_evo.plan.execute(plan, store, observer=bars, jobs=jobs, scheduler=scheduler)


def print_plan(plan: Plan, store: Store, *, as_json: bool) -> None:
    """Print the steps, their expected duration, and which are done; those of a group on one line."""
    done = {cell.digest for cell in plan if store.done(cell)}
    rows = [(cell.title, 0.0 if cell.digest in done else cell.expected_seconds, cell.digest in done) for cell in plan]
    total = sum(seconds for _, seconds, _ in rows)
    if as_json:
        cells = [{"cell": title, "seconds": round(seconds, 1), "kept": kept} for title, seconds, kept in rows]
        document = {"cells": cells, "seconds": round(total, 1), "remarks": list(plan.remarks)}
        out.print_json(data=document)
        return
    table = table_of("step", "about", numbers=("about",), whole=("about",))
    groups: dict[str, list[tuple[float, bool]]] = {}
    for cell, (title, about, kept) in zip(plan, rows, strict=True):
        groups.setdefault(cell.group or title, []).append((about, kept))
    for title, parts in groups.items():
        count = "" if len(parts) == 1 else f", {len(parts)} steps"
        needed = "kept" if all(kept for _, kept in parts) else f"{sum(seconds for seconds, _ in parts):.1f} s"
        table.add_row(f"{title}{count}", needed)
    out.print(table)
    out.print(f"{len(rows)} steps, {len(done)} kept, about {duration(total)}", highlight=False)


class PlanProgress(Observer):
    """An `Observer` that draws one bar for all cells and one for each, or prints lines without a terminal.

    ``go_on`` are the options that resume an interrupted command, if it can be resumed. ``where`` returns a prefix that
    distinguishes cells with the same title. ``elsewhere``: the cells are computed on workers that keep no checkpoints.
    ``cells`` are the cells of the plan; a group of cells gets one line when its last cell ends.
    """

    def __init__(
        self, go_on: str | None = None, *, cells: Iterable[Cell] = (), where: Callable[[Cell], str] | None = None,
        elsewhere: bool = False,
    ) -> None:  # fmt: skip
        self._go_on, self._where, self._elsewhere = go_on, where, elsewhere
        self._bars = _Bars(
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=12),
            TextColumn("{task.fields[note]}", justify="right", markup=False),
            TimeElapsedColumn(),
            console=err,
            transient=True,
            disable=not err.is_terminal or err.quiet,
        )
        self._all: TaskID | None = None
        self._current: dict[str, _Current] = {}
        self._cells = self._ended = self._failed = self._left_out = 0
        self._expected: dict[str, float] = {}
        self._awaited = Counter(self._group(cell) for cell in cells)
        self._grouped: dict[str, list[float]] = {}
        self._left = self._expected_done = 0.0
        self._began = time.monotonic()

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bars.stop()
        for group, seconds in self._grouped.items():
            self._print_group(group, len(seconds), sum(seconds))
        if self._left_out:
            steps = "1 step was" if self._left_out == 1 else f"{self._left_out} steps were"
            problems.print(f"{steps} left out, because other steps failed", highlight=False)
        if kind is not None and issubclass(kind, KeyboardInterrupt):
            titles = [one.title for one in self._current.values()]
            further = f" and {len(titles) - NAMED} more" if len(titles) > NAMED else ""
            what = ", ".join(titles[:NAMED]) + further or "between two steps"
            kept = "Unfinished work is not kept"
            resumable = [one for one in self._current.values() if one.resumable and one.done and not self._elsewhere]
            if len(self._current) > 1 and resumable:
                kept = f"The finished generations of {', '.join(one.title for one in resumable)} are kept"
            elif resumable:
                kept = f"The {resumable[0].done} of {resumable[0].total} finished generations are kept"
            on = "" if self._go_on is None else f"; to continue, repeat the command with {self._go_on}"
            print_status(f"interrupted: {what}. {kept}{on}")

    def plan(self, cells: int, kept: int, seconds: float) -> None:
        self._cells, self._left = cells, seconds
        if kept:
            print_status(f"{kept} of {cells} steps are done already", label="kept: ", style="dim")
        self._all = self._bars.add_task("all", total=cells, completed=0, note="")

    def start(self, cell: Cell) -> None:
        self._begin(cell.digest, self._title(cell), resumable=cell.resumable)
        self._expected[cell.digest] = cell.expected_seconds
        self._show_all()

    def begin(self, title: str) -> None:
        """Work outside a plan begins."""
        self._begin(title, title, resumable=False)

    def _begin(self, key: str, title: str, *, resumable: bool) -> None:
        self._remove(key)  # it was begun on another worker
        bar = self._bars.add_task(_short(title), total=None, note="", visible=len(self._current) < SHOWN)
        self._current[key] = _Current(title, bar, resumable)

    def progress(self, cell: Cell, done: int, total: int, note: str = "") -> None:
        if cell.digest in self._current:
            self._advance(self._current[cell.digest], done, total, note)

    def advance(self, done: int, total: int, note: str = "") -> None:
        """The running work has done ``done`` of ``total`` steps; ``note`` is a further remark."""
        for current in self._current.values():
            self._advance(current, done, total, note)

    def _advance(self, current: _Current, done: int, total: int, note: str) -> None:
        current.advance(done, total)
        pace = current.pace()
        self._bars.remarks[current.bar] = current.title, note
        self._bars.update(current.bar, completed=done, total=total or None, note=pace)
        now = time.monotonic()
        if not err.is_terminal and now - current.reported > REPORT_EVERY:
            current.reported = now
            done_so_far = ", ".join(filter(None, (f"{done}/{total}" if total else "running", pace)))
            print_status("; ".join(filter(None, (f"{self._count()}{current.title}: {done_so_far}", note))))

    def finish(self, cell: Cell, *, cached: bool, reason: str | None) -> None:
        self._ended += 1
        self._failed += reason is not None
        begun = cell.digest in self._expected
        if cell.digest in self._expected:
            expected = self._expected.pop(cell.digest)
            self._expected_done += expected
            self._left = max(0.0, self._left - expected)
        if reason is not None and not cached and not begun:
            self._left_out += 1  # a need has failed, which has a line of its own
        elif not cached or reason is not None:
            self._end(cell.digest, self._title(cell), reason, self._group(cell))
        self._end_of_group(self._group(cell))
        self._show_all()

    def _show_all(self) -> None:
        """Show in the bar for all cells how many are done, running and failed, and the time left."""
        if self._all is None:
            return
        pace = (time.monotonic() - self._began) / self._expected_done if self._expected_done else 1.0
        running = f", {len(self._current)} running" if len(self._current) > 1 else ""
        failed = f", {self._failed} failed" if self._failed else ""
        begun = self._expected_done >= MIN_DONE_SHARE * (self._expected_done + self._left)
        note = f"{self._ended} of {self._cells}{f', {duration(self._left * pace)} left' if begun else ''}"
        self._bars.update(self._all, description=f"all{running}{failed}", completed=self._ended, note=note)

    def end(self, title: str, reason: str | None) -> None:
        """Work outside a plan is done, or failed for a ``reason``."""
        self._end(title, title, reason)

    def _remove(self, key: str) -> float:
        """Remove the bar of finished work, show a hidden one instead; return the duration of the work."""
        current = self._current.pop(key, None)
        if current is None:
            return 0.0
        self._bars.remove_task(current.bar)
        self._bars.remarks.pop(current.bar, None)
        for other in list(self._current.values())[:SHOWN]:
            self._bars.update(other.bar, visible=True)
        return time.monotonic() - current.began

    def _end(self, key: str, title: str, reason: str | None, group: str = "") -> None:
        """Report that work has ended; without a terminal the cells of a ``group`` share one line."""
        seconds = self._remove(key)
        if reason is not None:
            problems.print(Text.assemble(("failed", "red"), f" {title}: {reason}"))
        elif err.is_terminal:
            return
        elif group:
            self._grouped.setdefault(group, []).append(seconds)
        else:
            print_status(f"{self._count()}{title}, {seconds:.1f} s", label="done ", style="green")

    def _end_of_group(self, group: str) -> None:
        self._awaited[group] -= 1
        if self._awaited[group] <= 0 and group in self._grouped:
            seconds = self._grouped.pop(group)
            self._print_group(group, len(seconds), sum(seconds))

    def _print_group(self, group: str, count: int, seconds: float) -> None:
        steps = f"{group}, {count} {'step' if count == 1 else 'steps'}, {seconds:.1f} s"
        print_status(f"{self._count()}{steps}", label="done ", style="green")

    def remark(self, sentence: str) -> None:
        note(sentence)

    def _title(self, cell: Cell) -> str:
        return cell.title if self._where is None else f"{self._where(cell)}{cell.title}"

    def _group(self, cell: Cell) -> str:
        where = "" if self._where is None else self._where(cell)
        return f"{where}{cell.group}" if cell.group else ""

    def _count(self) -> str:
        return f"{self._ended} of {self._cells}: " if self._cells else ""


class _Bars(Progress):
    """Bars, and below them ``remarks`` on the running work: in full for one, shortened for several."""

    def __init__(self, *columns: ProgressColumn, console: Console, transient: bool, disable: bool) -> None:
        self.remarks: dict[TaskID, tuple[str, str]] = {}
        super().__init__(*columns, console=console, transient=transient, disable=disable)

    def get_renderables(self) -> Iterable[RenderableType]:
        yield from super().get_renderables()
        noted = [pair for pair in self.remarks.values() if pair[1]][:SHOWN]
        if not noted:
            return
        width = self.console.width - 2
        lines = [f"  {_short(title)}: {remark.partition('; ')[0]}"[:width] for title, remark in noted]
        for _, remark in noted if len(noted) == 1 else ():
            lines = packed(remark, width)
        yield Text("\n".join(lines), style="dim")


@dataclass
class _Current:
    """Running work: its bar, its start and its progress."""

    title: str
    bar: TaskID
    resumable: bool = False
    began: float = field(default_factory=lambda: time.monotonic())
    reported: float = field(default_factory=lambda: time.monotonic())
    done: int = 0
    total: int = 0
    _first: tuple[int, float] | None = None

    def advance(self, done: int, total: int) -> None:
        self.done, self.total = done, total
        self._first = self._first or (done, time.monotonic())

    def pace(self) -> str:
        """Return rate and time left, measured from the first reported step, so that resumed steps do not count."""
        done, since = self._first or (0, self.began)
        steps, seconds = self.done - done, time.monotonic() - since
        if steps < 1 or seconds <= 0.0:
            return ""
        rate = f"{steps / seconds:,.1f}/s"
        if self.done < MIN_DONE_SHARE * self.total:
            return rate
        return f"{rate}, {duration((self.total - self.done) * seconds / steps)} left"


def packed(remark: str, width: int) -> list[str]:
    """Return ``remark`` in lines, which break at semicolons if possible."""
    lines = [""]
    for part in remark.split("; "):
        if lines[-1] and len(lines[-1]) + 2 + len(part) <= width:
            lines[-1] += f"; {part}"
        else:
            lines.append(part)
    return [f"  {line}" for line in lines[1:]]


def duration(seconds: float) -> str:
    """Return a time in seconds, minutes or hours."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _short(title: str, width: int = 30) -> str:
    width = max(SHORTEST, min(width, err.width - 45))
    return title if len(title) <= width else title[: width - 1] + "…"
