"""What is shown while work goes on: bars and a remark on a terminal, plain lines elsewhere."""

import io
import re

import pytest
from rich.console import Console

from sysid_evo.cli import console, progress
from sysid_evo.cli.progress import PlanProgress, duration
from tests.fixtures.cells import Number, number
from tests.fixtures.robots import ManualClock

NOTE = (
    "best 11.2, mean 8.1; linear 11.9, nearest_neighbour 11.2, parametrised 13.4; run 1 of 2; forwards 12, backwards 9"
)


def resumable(*given, **fields):
    return Number(*given, **fields).cell(resumable=True)


@pytest.fixture
def clock(monkeypatch):
    clock = ManualClock()
    monkeypatch.setattr(progress, "time", clock)
    return clock


@pytest.fixture
def shown(monkeypatch, clock):
    """A function that makes standard error a terminal of 80 columns, or no terminal, and gives what is written."""

    def on(*, terminal):
        written = io.StringIO()
        made = Console(file=written, force_terminal=terminal, width=80, height=24, color_system=None)
        for module in (console, progress):
            monkeypatch.setattr(module, "err", made)
            monkeypatch.setattr(module, "problems", made)
        return written

    return on


def drawn(written):
    """Return the lines of what was drawn, without the codes that move the cursor."""
    return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", written.getvalue()).replace("\r", "\n").rstrip().split("\n")


def finish(bars, *cells, reason=None):
    for cell in cells:
        bars.finish(cell, cached=False, reason=reason)


def test_on_a_terminal_of_80_columns_rate_time_left_and_remark_are_whole(shown, clock):
    written = shown(terminal=True)
    with PlanProgress() as bars:
        bars.begin("evolve linear+nearest_neighbour+parametrised")
        bars.advance(1, 300, NOTE)
        clock.sleep(29.0)
        bars.advance(30, 300, NOTE)
        bars._bars.refresh()
    lines = drawn(written)
    assert max(map(len, lines)) <= 80
    whole = [line.strip() for line in lines]
    assert "best 11.2, mean 8.1; linear 11.9, nearest_neighbour 11.2, parametrised 13.4" in whole
    assert "run 1 of 2; forwards 12, backwards 9" in whole
    assert any(re.search(r"evolve linear\S*… .* 1\.0/s, 4 min left 0:00:0", line) for line in lines)


def test_parallel_cells_have_a_line_each_and_their_remarks_below(shown, clock):
    written = shown(terminal=True)
    with PlanProgress() as bars:
        bars.plan(5, 0, 10.0)
        cells = [number(1, label="evolve linear+nearest_neighbour"), number(2, label="fit"), number(3, label="third")]
        for cell in cells:
            bars.start(cell)
        for done in (29, 30):
            bars.progress(cells[0], done, 300, NOTE)
            bars.progress(cells[1], done, 50, "error 0.25; and so on")
            clock.sleep(0.1)
        finish(bars, cells[2], reason="too little")
        bars._bars.refresh()
        last = drawn(written)[-5:]
    assert max(map(len, last)) <= 80
    assert [line.split()[0] for line in last] == ["all,", "count", "count", "count", "count"]
    assert last[0].startswith("all, 2 running, 1 failed")
    assert "1 of 5" in last[0]
    assert re.search(r"count evolve linear\S*… .* 10\.0/s, 27 s left", last[1])
    assert re.search(r"count fit .* 10\.0/s, 2 s left", last[2])
    assert [line.strip() for line in last[3:]] == [
        "count evolve linear+nearest_n…: best 11.2, mean 8.1",
        "count fit: error 0.25",
    ]


def test_an_interruption_reports_the_running_cells_and_the_kept_results(shown):
    written = shown(terminal=False)
    with PlanProgress("--out here") as bars:
        cells = [resumable(1, label="a"), number(2, label="b"), number(3, label="c")]
        for cell in cells:
            bars.start(cell)
            bars.progress(cell, 3, 9)
        finish(bars, cells[2])
        bars.__exit__(KeyboardInterrupt, None, None)
    line = written.getvalue().splitlines()[-1]
    assert line == (
        "interrupted: count a, count b. The finished generations of count a are kept; "
        "to continue, repeat the command with --out here"
    )


def test_an_interruption_keeps_nothing_of_cells_that_were_computed_elsewhere(shown):
    written = shown(terminal=False)
    with PlanProgress("--out here", elsewhere=True) as bars:
        for i in range(6):
            bars.start(resumable(i, label=str(i)))
            bars.progress(resumable(i, label=str(i)), 3, 9)
        bars.__exit__(KeyboardInterrupt, None, None)
    assert written.getvalue().splitlines()[-1] == (
        "interrupted: count 0, count 1, count 2, count 3 and 2 more. "
        "Unfinished work is not kept; to continue, repeat the command with --out here"
    )


def test_without_a_terminal_a_line_is_printed_now_and_then(shown, clock):
    written = shown(terminal=False)
    with PlanProgress() as bars:
        bars.begin("evolve linear")
        for done, at in ((1, 0.0), (20, 9.9), (30, 10.1), (31, 12.0)):
            clock.now = at
            bars.advance(done, 300, NOTE)
    assert written.getvalue() == f"evolve linear: 30/300, 2.9/s, 2 min left; {NOTE}\n"


@pytest.mark.parametrize(
    ("first", "done", "seconds", "said"),
    [
        (100, 140, 20.0, "140/300, 2.0/s, 80 s left"),  # what was done before an interruption does not count as fast
        (0, 29, 14.5, "29/300, 2.0/s"),  # before a tenth is done nothing is said of the time left
        (0, 30, 15.0, "30/300, 2.0/s, 2 min left"),
    ],
)
def test_rate_and_time_left_count_from_the_first_reported_step(first, done, seconds, said, shown, clock):
    written = shown(terminal=False)
    with PlanProgress() as bars:
        bars.begin("fit linear")
        bars.advance(first, 300)
        clock.sleep(seconds)
        bars.advance(done, 300)
    assert written.getvalue() == f"fit linear: {said}\n"


@pytest.mark.parametrize(("seconds", "said"), [(89.0, "89 s"), (90.0, "2 min"), (5399.0, "90 min"), (5400.0, "1.5 h")])
def test_a_time_is_shown_in_a_fitting_unit(seconds, said):
    assert duration(seconds) == said


def test_the_time_left_of_all_cells_is_shown_after_a_tenth_of_the_expected_time(shown):
    shown(terminal=True)
    with PlanProgress() as bars:
        bars.plan(20, 0, 20.0)
        told = []
        for i in range(2):
            bars.start(number(i))
            finish(bars, number(i))
            told.append("left" in bars._bars.tasks[0].fields["note"])
    assert told == [False, True]


def test_cells_of_one_group_have_one_line_and_a_failed_one_its_own(shown):
    written = shown(terminal=False)
    labels = ("a1", "b1", "a2", "c", "b2", "b3")
    cells = [
        Number(i, label=label).cell(group="" if label == "c" else f"count {label[0]}") for i, label in enumerate(labels)
    ]
    with PlanProgress(cells=cells) as bars:
        bars.plan(6, 0, 6.0)
        for cell in cells[:-1]:
            bars.start(cell)
            finish(bars, cell, reason="it broke" if cell.name == "b1" else None)
    assert written.getvalue().splitlines() == [
        "failed count b1: it broke",
        "done 3 of 6: count a, 2 steps, 0.0 s",
        "done 4 of 6: count c, 0.0 s",
        "done 5 of 6: count b, 1 step, 0.0 s",  # the end of what was done
    ]


def test_cells_of_one_title_are_distinguished_by_their_place(shown):
    written = shown(terminal=False)
    cells = [number(1, label="a"), number(2, label="a")]
    with PlanProgress(where=lambda cell: f"car {cells.index(cell) + 1}: ") as bars:
        bars.plan(2, 0, 2.0)
        for cell in cells:
            bars.start(cell)
        finish(bars, *cells)
    assert written.getvalue() == "done 1 of 2: car 1: count a, 0.0 s\ndone 2 of 2: car 2: count a, 0.0 s\n"


def test_many_cells_at_once_have_no_more_bars_than_a_terminal_has_lines(shown):
    shown(terminal=True)
    with PlanProgress() as bars:
        bars.plan(100, 0, 100.0)
        cells = [number(i) for i in range(20)]
        for cell in cells:
            bars.start(cell)
        assert sum(task.visible for task in bars._bars.tasks) == progress.SHOWN + 1
        finish(bars, *cells[:15])
        assert sum(task.visible for task in bars._bars.tasks) == 5 + 1


def test_a_cell_that_begins_again_elsewhere_has_one_bar(shown):
    shown(terminal=True)
    with PlanProgress() as bars:
        for _ in range(2):
            bars.start(number(1))
        assert len(bars._bars.tasks) == 1


def test_work_that_has_not_said_how_long_it_is_shows_no_numbers(shown, clock):
    written = shown(terminal=False)
    with PlanProgress() as bars:
        bars.begin("run linear on robot")
        clock.sleep(11.0)
        bars.advance(0, 0)
    assert "run linear on robot: running" in written.getvalue()


def test_steps_that_need_a_failed_one_share_a_line(shown):
    written = shown(terminal=False)
    with PlanProgress() as bars:
        fit, score, run = number(1, label="fit"), number(2, label="score"), number(3, label="run")
        bars.start(fit)
        finish(bars, fit, reason="boom")
        finish(bars, score, run, reason="needs fit, which failed")
    assert drawn(written)[-2:] == ["failed count fit: boom", "2 steps were left out, because other steps failed"]
