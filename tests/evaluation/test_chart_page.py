"""Plots, tables and commands of the page in a real browser: values under the pointer, lines off, rows in order."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
from playwright.sync_api import Locator, Page, expect

from evaluation.report import Report, save_report
from tests.fixtures.browser import DESK, PHONE, Visitor, shown
from tests.fixtures.known_models import Known, Sliding, Weak, fitted
from tests.fixtures.reports import make_report

HORIZON, FREE_RUN, CLAIMS = "Error over the horizon", "Predicted and measured", "Claimed and achieved"


@pytest.fixture(scope="module")
def report() -> Report:
    return make_report({"known": fitted(Known()), "weak": fitted(Weak()), "sliding": fitted(Sliding())})


@pytest.fixture(scope="module")
def report_page(report: Report, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save_report(report, tmp_path_factory.mktemp("page"))[1]


def figure(page: Page, title: str) -> Locator:
    return page.locator("figure").filter(has=page.get_by_role("heading", name=title, exact=True))


def hover(page: Page, title: str, across: float, down: float) -> str:
    """Point at a place of a figure, in shares of its drawing, and return what the tip says."""
    plot = figure(page, title).locator(".read").filter(visible=True).first
    left, top, width, height = plot.evaluate(
        "plot => { plot.scrollIntoView({block: 'center'}); const box = plot.getBoundingClientRect();"
        " return [box.left, box.top, box.width, box.height]; }"
    )
    page.mouse.move(left + across * width, top + down * height)
    return figure(page, title).locator(".tip").filter(visible=True).inner_text()


def rows_of(tip: str) -> dict[str, list[str]]:
    """Return value and interval by the name of the series."""
    rows = [line.strip().split("\t") for line in tip.splitlines() if "\t" in line]
    return {row[0]: row[1:] for row in rows}


def number(text: str) -> float:
    return float(text.replace("\u2212", "-"))


def column(table: Locator, place: int) -> list[str]:
    cells = table.locator(f"tbody td:nth-child({place + 1}), tbody th:nth-child({place + 1})")
    return [text.split("\n")[0] for text in cells.all_inner_texts()]


@pytest.mark.parametrize("width", [PHONE, DESK])
def test_pointing_at_a_plot_shows_every_value_with_its_interval(
    visitor: Visitor, report: Report, report_page: Path, width: int
) -> None:
    page = visitor.open(report_page, width=width)
    tip = hover(page, HORIZON, 0.6, 0.5)
    assert report.prediction is not None
    dt = report.prediction.cases.system.dt
    place = round(number(tip.split()[1]) / dt) - 1
    assert place > 5
    for name in ("weak", "sliding"):
        model, (value, interval) = report.prediction.model(name), rows_of(tip)[name]
        assert number(value) == pytest.approx(model.curve[place], rel=0.006)
        low, high = (number(end) for end in interval.split(" to "))
        assert (low, high) == pytest.approx(model.curve_interval[:, place], rel=0.006)
    assert list(rows_of(tip)) == sorted(rows_of(tip), key=lambda name: -number(rows_of(tip)[name][0]))
    box = page.locator(".tip").filter(visible=True).bounding_box()
    assert box is not None
    assert 0 <= box["x"] < box["x"] + box["width"] <= width


def test_pointing_at_a_controller_shows_what_it_claims_and_achieves(
    visitor: Visitor, report: Report, report_page: Path
) -> None:
    tip = hover(visitor.open(report_page), CLAIMS, 0.6, 0.1)
    assert report.transfer is not None
    first = report.transfer.controllers[0]
    assert tip.splitlines()[0] == first.name
    assert first.claimed is not None
    assert number(rows_of(tip)["claimed (where evolved)"][0]) == pytest.approx(first.claimed.value, abs=0.05)


def test_a_model_that_is_switched_off_is_hidden_in_every_plot_of_its_section_and_comes_back(
    visitor: Visitor, report_page: Path
) -> None:
    page = visitor.open(report_page)
    series = ('[data-series="1"]', '[data-series="2"]')
    before = [shown(page, one) for one in series]
    buttons = page.locator('.legend li[data-name="known"] button')
    expect(buttons).to_have_count(2)
    buttons.first.click()
    for button in buttons.all():
        expect(button).to_have_attribute("aria-pressed", "false")
    assert [shown(page, one) for one in series] < before
    for title in (HORIZON, FREE_RUN):
        assert "known" not in rows_of(hover(page, title, 0.6, 0.5))
    buttons.first.click()
    assert [shown(page, one) for one in series] == before
    assert "known" in rows_of(hover(page, HORIZON, 0.6, 0.5))


def test_the_arrow_keys_read_a_plot_aloud(visitor: Visitor, report_page: Path) -> None:
    plot = figure(visitor.open(report_page), FREE_RUN).locator(".read").first
    expect(plot).to_have_role("slider")
    expect(plot).to_have_accessible_name(re.compile("^Values of: "))
    said = []
    for place, key in enumerate(("Home", "ArrowRight", "ArrowRight", "ArrowDown")):
        plot.press(key)
        expect(plot).to_have_attribute("aria-valuenow", str(min(place, 2)))
        said.append(plot.get_attribute("aria-valuetext") or "")
    assert said[0].startswith("time ")
    assert "measured " in said[0]
    assert len(set(said)) == 4


def test_a_table_sorts_by_the_column_whose_head_is_clicked_and_back(visitor: Visitor, report_page: Path) -> None:
    table, place = visitor.open(report_page).locator("table.sorts").first, 1
    before = column(table, 0)
    head = table.locator("thead tr").first.locator("th, td").nth(place)
    orders = {}
    for expected in ("ascending", "descending", None):
        head.get_by_role("button").click()
        assert head.get_attribute("aria-sort") == expected
        orders[expected] = column(table, place)
    known = [float(value) for value in orders["ascending"] if value != "–"]
    assert known == sorted(known)
    assert [float(value) for value in orders["descending"] if value != "–"] == known[::-1]
    assert all(order[len(known) :] == ["–"] * (len(before) - len(known)) for order in list(orders.values())[:2])
    assert column(table, 0) == before


def test_the_command_of_the_controller_to_take_is_copied(visitor: Visitor, report: Report, tmp_path: Path) -> None:
    assert report.transfer is not None
    assert report.matrix is not None
    reached = {key: replace(cell, fitness=cell.fitness + 3.0) for key, cell in report.matrix.cells.items()}
    known = replace(
        report,
        matrix=replace(report.matrix, cells=reached),
        controllers={report.transfer.pick or "": "controllers/best.json"},
        settings={**report.settings, "robot": "emulated_car"},
    )
    page = visitor.open(save_report(known, tmp_path)[1], permissions=["clipboard-read", "clipboard-write"])
    command = page.locator(".command").first
    command.get_by_role("button").click()
    expect(command.get_by_role("button")).to_have_text("Copied")
    text = "sysid-evo drive --controller controllers/best.json --robot emulated_car"
    expect(command.locator("code")).to_have_text(text)
    assert page.evaluate("navigator.clipboard.readText()") == text


def test_without_a_script_lines_and_tables_are_there_and_no_button(visitor: Visitor, report_page: Path) -> None:
    page = visitor.open(report_page, java_script_enabled=False)
    expect(page.locator(".unplayed")).to_be_attached()
    assert shown(page, "[data-series]") > 10
    expect(page.locator("main button:not(.deck button)")).to_have_count(0)


def test_heads_of_tables_are_printed_again_on_the_next_page(visitor: Visitor, report_page: Path) -> None:
    """A button in a head that is printed again is left out, so that heads are text in print."""
    page = visitor.open(report_page)
    page.emulate_media(media="print")
    head = page.locator("thead").first
    expect(head).to_have_css("break-inside", "avoid")
    expect(head.locator("th").first).to_have_css("position", "static")
    expect(page.locator("thead th button").first).to_have_css("display", "contents")
