"""What is shown while work goes on: bars and a remark on a terminal, plain lines elsewhere."""

from __future__ import annotations

import io
import re
import time
from collections.abc import Callable
from types import SimpleNamespace

import pytest
from rich.console import Console

from sysid_evo.cli import console, progress
from sysid_evo.cli.progress import Bars
from tests.fixtures.cells import Number

NOTE = (
    "best 11.2, mean 8.1; linear 11.9, nearest_neighbour 11.2, parametrised 13.4; run 1 of 2; forwards 12, backwards 9"
)


@pytest.fixture
def shown(monkeypatch: pytest.MonkeyPatch) -> Callable[..., io.StringIO]:
    """A function that makes standard error a terminal of 80 columns, or no terminal, and gives what is written."""

    def on(*, terminal: bool) -> io.StringIO:
        written = io.StringIO()
        made = Console(file=written, force_terminal=terminal, width=80, height=24, color_system=None)
        for module in (console, progress):
            monkeypatch.setattr(module, "err", made)
            monkeypatch.setattr(module, "problems", made)
        return written

    return on


def advance(bars: Bars, *steps: int, note: str = "") -> None:
    for done in steps:
        bars.advance(done, 300, note)


def test_on_a_terminal_of_80_columns_rate_time_left_and_remark_are_whole(shown: Callable[..., io.StringIO]) -> None:
    written = shown(terminal=True)
    with Bars() as bars:
        bars.begin("evolve linear+nearest_neighbour+parametrised")
        advance(bars, 1, note=NOTE)
        time.sleep(0.01)
        advance(bars, 30, note=NOTE)
        bars._bars.refresh()
    lines = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", written.getvalue()).replace("\r", "\n").split("\n")
    assert max(map(len, lines)) <= 80
    whole = [line.strip() for line in lines]
    for line in ("best 11.2, mean 8.1; linear 11.9, nearest_neighbour 11.2, parametrised 13.4",
                 "run 1 of 2; forwards 12, backwards 9"):  # fmt: skip
        assert line in whole
    assert any(re.search(r"evolve linear\S*… .* [\d,.]+/s, \d+ (s|min) left 0:00:0", line) for line in lines)


def test_cells_side_by_side_have_a_line_each_and_what_they_reached_below(shown: Callable[..., io.StringIO]) -> None:
    written = shown(terminal=True)
    with Bars() as bars:
        bars.plan(5, 0, 10.0)
        cells = [Number(1, label="evolve linear+nearest_neighbour"), Number(2, label="fit"), Number(3, label="third")]
        for cell in cells:
            bars.start(cell)
        for done in (29, 30):
            bars.progress(cells[0], done, 300, NOTE)
            bars.progress(cells[1], done, 50, "error 0.25; and so on")
            time.sleep(0.01)
        bars.finish(cells[2], cached=False, reason="too little")
        bars._bars.refresh()
        drawn = written.getvalue()
    last = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", drawn).replace("\r", "\n").rstrip().split("\n")[-5:]
    assert max(map(len, last)) <= 80
    assert [line.split()[0] for line in last] == ["all,", "count", "count", "count", "count"]
    assert last[0].startswith("all, 2 running, 1 failed")
    assert "1 of 5" in last[0]
    assert re.search(r"count evolve linear\S*… .* [\d,.]+/s, \d+ (s|min) left", last[1])
    assert re.search(r"count fit .* [\d,.]+/s, \d+ (s|min) left", last[2])
    assert [line.strip() for line in last[3:]] == [
        "count evolve linear+nearest_n…: best 11.2, mean 8.1",
        "count fit: error 0.25",
    ]


def test_an_interruption_says_what_went_on_and_what_of_it_is_kept(shown: Callable[..., io.StringIO]) -> None:
    class Resumable(Number):
        resumable = True

    written = shown(terminal=False)
    with Bars("--out here") as bars:
        kept, lost, ended = Resumable(1, label="a"), Number(2, label="b"), Number(3, label="c")
        for cell in (kept, lost, ended):
            bars.start(cell)
            bars.progress(cell, 3, 9)
        bars.finish(ended, cached=False, reason=None)
        bars.__exit__(KeyboardInterrupt, None, None)
    line = written.getvalue().splitlines()[-1]
    assert line == "interrupted: count a, count b. What is done of count a is kept; go on with --out here"


def test_without_a_terminal_a_line_now_and_then_says_the_same(
    shown: Callable[..., io.StringIO], monkeypatch: pytest.MonkeyPatch
) -> None:
    written = shown(terminal=False)
    monkeypatch.setattr(progress, "REPORT_EVERY", 0.02)
    with Bars() as bars:
        bars.begin("evolve linear")
        advance(bars, 1, note=NOTE)
        time.sleep(0.03)
        advance(bars, 30, 31, note=NOTE)
    (line,) = written.getvalue().splitlines()
    assert re.fullmatch(rf"evolve linear: 30/300, [\d,.]+/s, \d+ (s|min) left; {re.escape(NOTE)}", line)


def test_what_was_done_before_an_interruption_does_not_count_as_fast(
    shown: Callable[..., io.StringIO], monkeypatch: pytest.MonkeyPatch
) -> None:
    written = shown(terminal=False)
    now = [0.0]
    monkeypatch.setattr(progress, "time", SimpleNamespace(monotonic=lambda: now[0]))
    with Bars() as bars:
        bars.begin("evolve linear")
        advance(bars, 100)
        now[0] = 20.0
        advance(bars, 140)
    assert written.getvalue() == "evolve linear: 140/300, 2.0/s, 80 s left\n"


@pytest.mark.parametrize(("done", "left"), [(29, ""), (30, ", 135 s left")])
def test_nothing_is_said_of_the_time_left_before_a_tenth_is_done(
    done: int, left: str, shown: Callable[..., io.StringIO], monkeypatch: pytest.MonkeyPatch
) -> None:
    written = shown(terminal=False)
    now = [0.0]
    monkeypatch.setattr(progress, "time", SimpleNamespace(monotonic=lambda: now[0]))
    with Bars() as bars:
        bars.begin("fit linear")
        advance(bars, 0)
        now[0] = done / 2
        advance(bars, done)
    assert written.getvalue() == f"fit linear: {done}/300, 2.0/s{left.replace('135 s', '2 min')}\n"


def test_the_time_left_of_all_cells_is_said_from_a_tenth_of_what_is_foreseen_on(
    shown: Callable[..., io.StringIO],
) -> None:
    shown(terminal=True)
    with Bars() as bars:
        bars.plan(20, 0, 20.0)
        told = []
        for i in range(2):
            bars.start(Number(i))
            bars.finish(Number(i), cached=False, reason=None)
            told.append("left" in bars._bars.tasks[0].fields["note"])
    assert told == [False, True]


def test_cells_of_one_group_have_one_line_and_a_failed_one_its_own(shown: Callable[..., io.StringIO]) -> None:
    class Run(Number):
        @property
        def group(self) -> str:
            return f"count {self.label[0]}"

    written = shown(terminal=False)
    labels = ("a1", "b1", "a2", "c", "b2", "b3")
    cells = [Number(9, label=label) if label == "c" else Run(i, label=label) for i, label in enumerate(labels)]
    with Bars(cells=cells) as bars:
        bars.plan(6, 0, 6.0)
        for cell in cells[:-1]:
            bars.start(cell)
            bars.finish(cell, cached=False, reason="it broke" if cell.label == "b1" else None)
    assert [re.sub(r", [\d.]+ s$", "", line) for line in written.getvalue().splitlines()] == [
        "failed count b1: it broke",
        "done 3 of 6: count a, 2 cells",
        "done 4 of 6: count c",
        "done 5 of 6: count b, 1 cell",  # the end of what was done
    ]


def test_cells_of_one_title_are_told_apart_by_where_they_are(shown: Callable[..., io.StringIO]) -> None:
    written = shown(terminal=False)
    cells = [Number(1, label="a"), Number(2, label="a")]
    with Bars(where=lambda cell: f"car {cells.index(cell) + 1}: ") as bars:
        bars.plan(2, 0, 2.0)
        for cell in cells:
            bars.start(cell)
        for cell in cells:
            bars.finish(cell, cached=False, reason=None)
    assert [line.rpartition(",")[0] for line in written.getvalue().splitlines()] == [
        "done 1 of 2: car 1: count a", "done 2 of 2: car 2: count a"
    ]  # fmt: skip


def test_many_cells_at_once_have_no_more_bars_than_a_terminal_has_lines(shown: Callable[..., io.StringIO]) -> None:
    shown(terminal=True)
    with Bars() as bars:
        bars.plan(100, 0, 100.0)
        cells = [Number(i) for i in range(50)]
        for cell in cells:
            bars.start(cell)
        assert sum(task.visible for task in bars._bars.tasks) == progress.SHOWN + 1
        for cell in cells[:45]:
            bars.finish(cell, cached=False, reason=None)
        assert sum(task.visible for task in bars._bars.tasks) == 5 + 1


def test_a_cell_that_begins_again_elsewhere_has_one_bar(shown: Callable[..., io.StringIO]) -> None:
    shown(terminal=True)
    with Bars() as bars:
        for _ in range(2):
            bars.start(Number(1))
        assert len(bars._bars.tasks) == 1


def test_an_interruption_keeps_nothing_of_cells_that_were_computed_elsewhere(shown: Callable[..., io.StringIO]) -> None:
    class Resumable(Number):
        resumable = True

    written = shown(terminal=False)
    with Bars("--out here", elsewhere=True) as bars:
        for i in range(6):
            bars.start(Resumable(i, label=str(i)))
            bars.progress(Resumable(i, label=str(i)), 3, 9)
        bars.__exit__(KeyboardInterrupt, None, None)
    assert written.getvalue().splitlines()[-1] == (
        "interrupted: count 0, count 1, count 2, count 3 and 2 more. Nothing unfinished is kept; go on with --out here"
    )
