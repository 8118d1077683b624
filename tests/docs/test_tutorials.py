"""Every tutorial works as it stands: files, commands and Python, from an empty folder, in the order of the page."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

from tests.docs.blocks import PAGES
from tests.docs.running import SMALL, picture, run_page, shown_on, words_of

TUTORIALS = [page for page in PAGES if page.startswith("tutorials/")]
WIDTH = 80
LARGEST = 120_000
"""Bytes of a picture, so that a page is there at once."""


@pytest.mark.parametrize("page", TUTORIALS)
def test_a_tutorial_runs_from_an_empty_folder(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No line that is printed is wider than the terminal, but paths and commands; the pictures are those of the runs.

    A picture of a smaller budget has other numbers, so it is told by what is written in it.
    """
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", str(WIDTH))
    for said in run_page(page, tmp_path, SMALL):
        wide = [row for row in said.printed.splitlines() if len(row.rstrip()) > WIDTH]
        assert not [row for row in wide if not re.search(rf"\S{os.sep}\S|use:|check:", row)], said.line
    for run, figure in shown_on(page):
        shown, made = picture(run, figure), tmp_path / "runs" / run / "figures" / f"{figure}.svg"
        assert words_of(shown) == words_of(made), "make pictures"
        assert shown.stat().st_size < LARGEST


def test_every_picture_of_a_run_is_shown_somewhere() -> None:
    shown = {picture(run, figure) for page in PAGES for run, figure in shown_on(page)}
    assert set(picture("any", "any").parent.glob("*.svg")) == shown
