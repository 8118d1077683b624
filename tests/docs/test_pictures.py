"""The picture of the README: what takes it, and that it is one of the size that is taken."""

from __future__ import annotations

import shutil
import struct
from pathlib import Path

import pytest

from tests.docs.pictures import README, REPORT, SCREEN, first_screen

ROOT = Path(__file__).parents[2]


def size_of(png: Path) -> tuple[int, ...]:
    head = png.read_bytes()[:24]
    assert head.startswith(b"\x89PNG")
    return struct.unpack(">II", head[16:])


def test_the_readme_shows_a_picture_of_the_size_that_is_taken() -> None:
    assert f"]({REPORT.relative_to(ROOT).as_posix()})" in (ROOT / README).read_text()
    assert size_of(REPORT) == SCREEN
    assert REPORT.stat().st_size < 120_000


@pytest.mark.skipif(shutil.which("chromium") is None, reason="no chromium is installed")
def test_the_first_screen_of_a_page_is_taken(tmp_path: Path) -> None:
    page, file = tmp_path / "page.html", tmp_path / "page.png"
    page.write_text("<p style='height: 5000px'>Long</p>")
    first_screen(page, file)
    assert size_of(file) == SCREEN
