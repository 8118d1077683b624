"""The page in a real browser, offline: on a desk and on a phone, in the light and in the dark."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from evaluation.plots.theme import LINES, PAPER
from evaluation.report import save_report
from tests.chromium import Chromium, Tab, find_chromium
from tests.evaluation.known_models import Known, Sliding, fitted
from tests.evaluation.test_report import make_report

LONG = "a_family_with_a_very_long_name_indeed+and_another_of_the_same_length"
PHONE, DESK = 375, 1280


@pytest.fixture(scope="module")
def tab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tab]:
    folder = tmp_path_factory.mktemp("page")
    _, page = save_report(make_report({LONG: fitted(Known()), "sliding": fitted(Sliding())}), folder)
    with Chromium(find_chromium(), folder / "profile") as browser:
        yield browser.open(page.as_uri())


def seen(tab: Tab, folder: Path, width: int, *, height: int = 800, dark: bool = False) -> np.ndarray:
    """Return what the browser shows at this size, (height, width, 3), from 0 to 1."""
    tab.picture(folder / "page.png", width=width, height=height, dark=dark)
    return np.asarray(imread(folder / "page.png")[:, :, :3])


def share_of(colour: str, pixels: np.ndarray) -> float:
    wanted = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
    return float((np.abs(pixels - wanted).max(axis=2) < 0.02).mean())


def shown(tab: Tab, selector: str) -> int:
    """Return how many elements of a kind have a size on the screen."""
    found = tab.evaluate(f"[...document.querySelectorAll('{selector}')].filter(e => e.getClientRects().length).length")
    return int(found)


@pytest.mark.parametrize("width", [320, PHONE, 768, DESK])
def test_the_page_is_as_wide_as_the_screen(tab: Tab, tmp_path: Path, width: int) -> None:
    seen(tab, tmp_path, width)
    assert tab.evaluate("document.documentElement.scrollWidth") <= width
    assert tab.evaluate("innerWidth") == width


def test_a_table_that_is_too_wide_scrolls_in_itself_and_its_edge_is_shaded(tab: Tab, tmp_path: Path) -> None:
    seen(tab, tmp_path, PHONE)
    widths = "[...document.querySelectorAll('section > .scroll')].map(e => e.scrollWidth - e.clientWidth)"
    assert max(tab.evaluate(widths)) > 50
    style = "getComputedStyle(document.querySelector('.scroll'))"
    assert tab.evaluate(f"{style}.overflowX") == "auto"
    assert tab.evaluate(f"{style}.backgroundAttachment") == "local, local, scroll, scroll"


def test_the_colours_follow_the_theme_of_the_reader(tab: Tab, tmp_path: Path) -> None:
    light, dark = (seen(tab, tmp_path, DESK, height=2600, dark=dark) for dark in (False, True))
    assert share_of(PAPER.light, light) > 0.5
    assert share_of(PAPER.dark, dark) > 0.5
    # the lines of the plots change with it; vermilion occurs in pictures alone
    vermilion = LINES[1]
    assert share_of(vermilion.light, light) > 1e-4
    assert share_of(vermilion.dark, dark) > 1e-4
    assert share_of(vermilion.light, dark) < 1e-5


def test_a_phone_gets_the_drawings_made_for_it(tab: Tab, tmp_path: Path) -> None:
    seen(tab, tmp_path, DESK)
    assert (shown(tab, ".on-wide > svg") > 0, shown(tab, ".on-narrow > svg")) == (True, 0)
    seen(tab, tmp_path, PHONE)
    assert (shown(tab, ".on-wide > svg"), shown(tab, ".on-narrow > svg") > 0) == (0, True)


@pytest.mark.parametrize("width", [PHONE, DESK])
def test_labels_of_the_plots_are_large_enough_to_read(tab: Tab, tmp_path: Path, width: int) -> None:
    seen(tab, tmp_path, width)
    sizes = tab.evaluate(
        "[...document.querySelectorAll('figure svg text')].filter(e => e.getClientRects().length)"
        ".map(e => [parseFloat(getComputedStyle(e).fontSize), e.getScreenCTM()])"
        ".map(([size, m]) => size * Math.sqrt(Math.abs(m.a * m.d - m.b * m.c)))"
    )
    assert len(sizes) > 20
    assert min(sizes) >= 7.5
    assert np.median(sizes) >= 10.0


def test_the_drawings_have_ink_all_the_way_down(tab: Tab, tmp_path: Path) -> None:
    pixels = seen(tab, tmp_path, DESK, height=6000)
    inked = pixels.min(axis=2) < 0.5
    assert np.count_nonzero(inked.sum(axis=1)) > 1500
    # nothing sticks out of the column of 60 rem
    assert not inked[:, 1200:].any()


def test_headings_go_down_one_level_at_a_time(tab: Tab) -> None:
    levels = tab.evaluate("[...document.querySelectorAll('h1, h2, h3, h4')].map(e => Number(e.tagName[1]))")
    assert levels[0] == 1
    assert all(after - before <= 1 for before, after in pairwise(levels))
