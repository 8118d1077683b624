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
        advance(bars, 2, note=NOTE)
        bars._bars.refresh()
    lines = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", written.getvalue()).replace("\r", "\n").split("\n")
    assert max(map(len, lines)) <= 80
    whole = [line.strip() for line in lines]
    for line in ("best 11.2, mean 8.1; linear 11.9, nearest_neighbour 11.2, parametrised 13.4",
                 "run 1 of 2; forwards 12, backwards 9"):  # fmt: skip
        assert line in whole
    assert any(re.search(r"evolve linear\S*… .* [\d,.]+/s, \d+ (s|min) left 0:00:0", line) for line in lines)


def test_without_a_terminal_a_line_now_and_then_says_the_same(
    shown: Callable[..., io.StringIO], monkeypatch: pytest.MonkeyPatch
) -> None:
    written = shown(terminal=False)
    monkeypatch.setattr(progress, "REPORT_EVERY", 0.02)
    with Bars() as bars:
        bars.begin("evolve linear")
        advance(bars, 1, note=NOTE)
        time.sleep(0.03)
        advance(bars, 2, 3, note=NOTE)
    (line,) = written.getvalue().splitlines()
    assert re.fullmatch(rf"evolve linear: 2/300, [\d,.]+/s, \d+ (s|min) left; {re.escape(NOTE)}", line)


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
