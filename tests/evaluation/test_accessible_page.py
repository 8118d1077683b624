"""The page for everyone: what axe-core finds, in the light and in the dark, on a desk and on a phone, and on paper.

axe-core is that of the package ``axe-core-python``, or a newer one where ``AXE_CORE`` says.
"""

from __future__ import annotations

import base64
import os
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path

import pytest

from evaluation.report import save_report
from evaluation.report.two_runs import differences, save_comparison
from tests.chromium import Chromium, Tab, find_chromium
from tests.evaluation.known_models import Known, Sliding, fitted
from tests.evaluation.test_page import shown
from tests.evaluation.test_replay_page import DESK, PHONE, opened
from tests.evaluation.test_report import make_report

PAPER = 718
"""CSS pixels across a sheet of A4 within its margins."""
FOUND = "axe.run(document).then(found => found.violations.map(one => `${one.id}: ${one.nodes[0].html}`))"


@pytest.fixture(scope="module")
def axe() -> str:
    """The source of axe-core."""
    if "AXE_CORE" in os.environ:
        return Path(os.environ["AXE_CORE"]).read_text()
    return files("axe_core_python").joinpath("axe.min.js").read_text("utf-8")


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chromium]:
    with Chromium(find_chromium(), tmp_path_factory.mktemp("profile")) as browser:
        yield browser


@pytest.fixture(scope="module")
def pages(browser: Chromium, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Tab]:
    """The page of a run, and that of two runs."""
    folder = tmp_path_factory.mktemp("page")
    report = make_report({"known": fitted(Known()), "sliding": fitted(Sliding())})
    two = save_comparison(differences(report, report, ("before", "after")), folder)
    other = browser.open(two.as_uri())
    return {"one run": opened(browser, save_report(report, folder)[1]), "two runs": other}


@pytest.mark.parametrize("which", ["one run", "two runs"])
@pytest.mark.parametrize(("width", "dark"), [(DESK, False), (DESK, True), (PHONE, False)])
def test_axe_finds_nothing(pages: dict[str, Tab], axe: str, which: str, width: int, dark: bool, tmp_path: Path) -> None:
    tab = pages[which]
    tab.picture(tmp_path / "page.png", width=width, height=800, dark=dark)
    if tab.evaluate("typeof axe") == "undefined":
        tab.evaluate(f"{axe};0")
    assert tab.evaluate(FOUND) == []


@pytest.mark.parametrize("width", [PHONE, 768, DESK])
def test_the_page_of_two_runs_is_as_wide_as_the_screen(pages: dict[str, Tab], width: int, tmp_path: Path) -> None:
    pages["two runs"].picture(tmp_path / "page.png", width=width, height=800)
    assert pages["two runs"].evaluate("document.documentElement.scrollWidth") <= width


def test_paper_gets_no_buttons_and_no_player_and_all_that_is_folded_away(pages: dict[str, Tab], tmp_path: Path) -> None:
    tab = pages["one run"]
    tab.picture(tmp_path / "page.png", width=PAPER, height=800)
    tab.call("Emulation.setEmulatedMedia", media="print")
    try:
        for gone in (".deck", ".screens", "nav", ".tip", ".watch", ".command button"):
            assert shown(tab, gone) == 0, gone
        assert shown(tab, "figure svg") > 4
        assert tab.evaluate("document.documentElement.scrollWidth") <= PAPER
    finally:
        tab.call("Emulation.setEmulatedMedia", media="")
    pdf = base64.b64decode(tab.call("Page.printToPDF", printBackground=True)["data"])
    assert pdf.startswith(b"%PDF")
    assert pdf.count(b"/Type /Page\n") + pdf.count(b"/Type /Page ") + pdf.count(b"/Type/Page") > 3
