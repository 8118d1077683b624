"""The page in a real browser, offline: on a desk and on a phone, in the light and in the dark."""

from itertools import pairwise

import numpy as np
import pytest

from evaluation.plot_style import LINES, PAPER
from evaluation.report import save_report
from tests.fixtures.browser import DESK, PHONE, TABLET, resize, seen, share_of, shown, sideways
from tests.fixtures.known_models import Known, Sliding, fitted
from tests.fixtures.reports import make_report

LONG = "a_family_with_a_very_long_name_indeed+and_another_of_the_same_length"


@pytest.fixture(scope="module")
def report_page(tmp_path_factory):
    report = make_report({LONG: fitted(Known()), "sliding": fitted(Sliding())})
    return save_report(report, tmp_path_factory.mktemp("page"))[1]


def test_the_page_is_as_wide_as_the_screen(visitor, report_page):
    page = visitor.open(report_page)
    for width in (320, PHONE, TABLET, DESK):
        resize(page, width)
        assert sideways(page) == 0, width
        assert page.evaluate("innerWidth") == width


def test_a_table_that_is_too_wide_scrolls_in_itself_and_its_edge_is_shaded(visitor, report_page):
    page = visitor.open(report_page, width=PHONE)
    tables = page.locator("section > .scroll")
    assert max(tables.evaluate_all("all => all.map(e => e.scrollWidth - e.clientWidth)")) > 50
    overflow, attachment = tables.first.evaluate(
        "e => [getComputedStyle(e).overflowX, getComputedStyle(e).backgroundAttachment]"
    )
    assert overflow == "auto"
    assert attachment == "local, local, scroll, scroll"


def test_the_colours_follow_the_theme_of_the_reader(visitor, report_page):
    page = visitor.open(report_page, height=2600)
    light = seen(page)
    page.emulate_media(color_scheme="dark")
    dark = seen(page)
    assert share_of(PAPER.light, light) > 0.5
    assert share_of(PAPER.dark, dark) > 0.5
    # the lines of the plots change with it; vermilion occurs in pictures alone
    vermilion = LINES[1]
    assert share_of(vermilion.light, light) > 1e-4
    assert share_of(vermilion.dark, dark) > 1e-4
    assert share_of(vermilion.light, dark) < 1e-5


def test_a_phone_gets_the_drawings_made_for_it(visitor, report_page):
    page = visitor.open(report_page, width=DESK)
    assert (shown(page, ".on-wide > svg") > 0, shown(page, ".on-narrow > svg")) == (True, 0)
    resize(page, PHONE)
    assert (shown(page, ".on-wide > svg"), shown(page, ".on-narrow > svg") > 0) == (0, True)


def test_labels_of_the_plots_are_large_enough_to_read(visitor, report_page):
    page = visitor.open(report_page)
    for width in (PHONE, DESK):
        resize(page, width)
        sizes = page.locator("figure svg text").evaluate_all(
            "all => all.filter(e => e.getClientRects().length)"
            ".map(e => [parseFloat(getComputedStyle(e).fontSize), e.getScreenCTM()])"
            ".map(([size, m]) => size * Math.sqrt(Math.abs(m.a * m.d - m.b * m.c)))"
        )
        assert len(sizes) > 20
        assert min(sizes) >= 7.5
        assert np.median(sizes) >= 10.0


def test_the_drawings_have_ink_all_the_way_down(visitor, report_page):
    inked = seen(visitor.open(report_page, height=6000)).min(axis=2) < 0.5
    assert np.count_nonzero(inked.sum(axis=1)) > 1500
    # nothing sticks out of the column of 60 rem
    assert not inked[:, 1200:].any()


def test_headings_go_down_one_level_at_a_time(visitor, report_page):
    page = visitor.open(report_page)
    levels = page.locator("h1, h2, h3, h4").evaluate_all("all => all.map(e => Number(e.tagName[1]))")
    assert levels[0] == 1
    assert all(after - before <= 1 for before, after in pairwise(levels))
