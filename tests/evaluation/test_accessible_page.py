"""The pages for everyone: what axe-core finds, in the light and in the dark, on a desk and on a phone, and on paper.

axe-core is that of the package ``axe-core-python``, or a newer one where ``AXE_CORE`` says.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Literal

import pytest
from axe_core_python.sync_playwright import Axe

from evaluation.report import save_report
from evaluation.report.study import save_study
from tests.fixtures.browser import DESK, PHONE, TABLET, Visitor, resize, shown, sideways
from tests.fixtures.known_models import Known, Sliding, fitted
from tests.fixtures.reports import make_report
from tests.fixtures.studies import made_up

PAPER = 718
"""CSS pixels across a sheet of A4 within its margins."""
PAGES = ("run", "study")


@pytest.fixture(scope="module")
def axe() -> Axe:
    return Axe.from_file(os.environ["AXE_CORE"]) if "AXE_CORE" in os.environ else Axe()


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The page of a run, and that of a study."""
    folder = tmp_path_factory.mktemp("page")
    report = make_report({"known": fitted(Known()), "sliding": fitted(Sliding())})
    study = save_study(made_up(recipe=["recommended", "plain"]), folder)
    return {"run": save_report(report, folder)[1], "study": study[-1]}


@pytest.mark.parametrize("which", PAGES)
def test_axe_finds_nothing(visitor: Visitor, pages: dict[str, Path], axe: Axe, which: str) -> None:
    page = visitor.open(pages[which])
    looks: list[tuple[int, Literal["dark", "light"]]] = [(DESK, "light"), (DESK, "dark"), (PHONE, "light")]
    for width, scheme in looks:
        resize(page, width)
        page.emulate_media(color_scheme=scheme)
        found = axe.run(page, options={"resultTypes": ["violations"]})
        assert [f"{one['id']}: {one['nodes'][0]['html']}" for one in found["violations"]] == [], (width, scheme)


@pytest.mark.parametrize("which", PAGES)
def test_the_page_is_as_wide_as_the_screen(visitor: Visitor, pages: dict[str, Path], which: str) -> None:
    page = visitor.open(pages[which])
    for width in (PHONE, TABLET, DESK):
        resize(page, width)
        assert sideways(page) == 0, width


def test_paper_gets_no_buttons_and_no_player_and_all_that_is_folded_away(
    visitor: Visitor, pages: dict[str, Path]
) -> None:
    page = visitor.open(pages["run"], width=PAPER)
    page.emulate_media(media="print")
    for gone in (".deck", ".screens", "nav", ".tip", ".watch", ".command button"):
        assert shown(page, gone) == 0, gone
    assert shown(page, "figure svg") > 4
    assert sideways(page) == 0


@pytest.mark.parametrize(("which", "least"), [("run", 4), ("study", 2)])
def test_a_page_is_printed_on_several_sheets(visitor: Visitor, pages: dict[str, Path], which: str, least: int) -> None:
    pdf = visitor.open(pages[which]).pdf(format="A4", print_background=True)
    assert pdf.startswith(b"%PDF")
    assert pdf.count(b"/Type /Page\n") + pdf.count(b"/Type /Page ") + pdf.count(b"/Type/Page") >= least
