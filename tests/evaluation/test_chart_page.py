"""Plots, tables and commands of the page in a real browser: values under the pointer, lines off, rows in order."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from evaluation.report import Report, save_report
from tests.chromium import Chromium, Tab, find_chromium
from tests.evaluation.known_models import Known, Sliding, Weak, fitted
from tests.evaluation.test_page import shown
from tests.evaluation.test_replay_page import DESK, PHONE, opened
from tests.evaluation.test_report import make_report

HORIZON, FREE_RUN, CLAIMS = "Error over the horizon", "Predicted and measured", "Claimed and achieved"


@pytest.fixture(scope="module")
def report() -> Report:
    return make_report({"known": fitted(Known()), "weak": fitted(Weak()), "sliding": fitted(Sliding())})


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chromium]:
    with Chromium(find_chromium(), tmp_path_factory.mktemp("profile")) as browser:
        yield browser


@pytest.fixture(scope="module")
def page(report: Report, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save_report(report, tmp_path_factory.mktemp("page"))[1]


@pytest.fixture(scope="module")
def tab(browser: Chromium, page: Path) -> Tab:
    return opened(browser, page)


def figure(title: str) -> str:
    return f"[...document.querySelectorAll('figure')].find(e => e.querySelector('h3').textContent === '{title}')"


def hover(tab: Tab, title: str, across: float, down: float) -> str:
    """Point at a place of a figure, in shares of its drawing, and return what the tip says."""
    tab.to_front()
    left, top, width, height = tab.evaluate(
        f"(() => {{ const plot = [...{figure(title)}.querySelectorAll('.read')].find(e => e.getClientRects().length);"
        " plot.scrollIntoView({block: 'center'}); const box = plot.getBoundingClientRect();"
        " return [box.left, box.top, box.width, box.height]; })()"
    )
    tab.move_to(left + across * width, top + down * height)
    tab.wait_for(f"[...{figure(title)}.querySelectorAll('.tip')].some(e => !e.hidden)")
    return str(tab.evaluate(f"[...{figure(title)}.querySelectorAll('.tip')].find(e => !e.hidden).innerText"))


def rows_of(tip: str) -> dict[str, list[str]]:
    """Return value and interval by the name of the series."""
    rows = [line.strip().split("\t") for line in tip.splitlines() if "\t" in line]
    return {row[0]: row[1:] for row in rows}


def number(text: str) -> float:
    return float(text.replace("\u2212", "-"))


def column(tab: Tab, table: str, place: int) -> list[str]:
    found: list[str] = tab.evaluate(
        f"[...{table}.tBodies[0].rows].map(row => row.cells[{place}].innerText.split('\\n')[0])"
    )
    return found


@pytest.mark.parametrize("width", [PHONE, DESK])
def test_pointing_at_a_plot_shows_every_value_with_its_interval(
    tab: Tab, report: Report, width: int, tmp_path: Path
) -> None:
    tab.picture(tmp_path / "page.png", width=width, height=800)
    tip = hover(tab, HORIZON, 0.6, 0.5)
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
    box: list[float] = tab.evaluate(
        "(() => { const tip = [...document.querySelectorAll('.tip')].find(e => !e.hidden).getBoundingClientRect();"
        " return [tip.left, tip.right]; })()"
    )
    assert 0 <= box[0] < box[1] <= width


def test_pointing_at_a_controller_shows_what_it_claims_and_achieves(tab: Tab, report: Report, tmp_path: Path) -> None:
    tab.picture(tmp_path / "page.png", width=DESK, height=800)
    tip = hover(tab, CLAIMS, 0.6, 0.1)
    assert report.transfer is not None
    first = report.transfer.controllers[0]
    assert tip.splitlines()[0] == first.name
    assert first.claimed is not None
    assert number(rows_of(tip)["claimed (where evolved)"][0]) == pytest.approx(first.claimed.value, abs=0.05)


def test_a_model_that_is_switched_off_is_hidden_in_every_plot_of_its_section_and_comes_back(
    tab: Tab, tmp_path: Path
) -> None:
    tab.picture(tmp_path / "page.png", width=DESK, height=800)
    seen = [shown(tab, f'[data-series="{number}"]') for number in (1, 2)]
    tab.click('.legend li[data-name="known"] button')
    pressed = "[...document.querySelectorAll('.legend li[data-name=\"known\"] button')].map(e => e.ariaPressed)"
    assert set(tab.evaluate(pressed)) == {"false"}
    assert len(tab.evaluate(pressed)) == 2
    assert [shown(tab, f'[data-series="{number}"]') for number in (1, 2)] < seen
    for title in (HORIZON, FREE_RUN):
        assert "known" not in rows_of(hover(tab, title, 0.6, 0.5))
    tab.click('.legend li[data-name="known"] button')
    assert [shown(tab, f'[data-series="{number}"]') for number in (1, 2)] == seen
    assert "known" in rows_of(hover(tab, HORIZON, 0.6, 0.5))


def test_the_arrow_keys_read_a_plot_aloud(tab: Tab) -> None:
    tab.to_front()
    plot = f"{figure(FREE_RUN)}.querySelector('.read')"
    tab.evaluate(f"{plot}.focus()")
    said: list[Any] = []
    for code in ("Home", "ArrowRight", "ArrowRight", "ArrowDown"):
        tab.press(code)
        tab.release(code)
        said.append([tab.evaluate(f"{plot}.ariaValueNow"), tab.evaluate(f"{plot}.ariaValueText")])
    assert [int(now) for now, _ in said] == [0, 1, 2, 2]
    assert said[0][1].startswith("time ")
    assert "measured " in said[0][1]
    assert len({text for _, text in said}) == 4
    assert tab.evaluate(f"{plot}.role") == "slider"
    assert tab.evaluate(f"{plot}.ariaLabel").startswith("Values of: ")


def test_a_table_sorts_by_the_column_whose_head_is_clicked_and_back(tab: Tab) -> None:
    table = "document.querySelector('table.sorts')"
    before, place = column(tab, table, 0), 1
    head = f"{table}.tHead.rows[0].cells[{place}]"
    orders = {}
    for expected in ("ascending", "descending", None):
        tab.evaluate(f"{head}.querySelector('button').click()")
        assert tab.evaluate(f"{head}.ariaSort") == expected
        orders[expected] = column(tab, table, place)
    known = [float(value) for value in orders["ascending"] if value != "–"]
    assert known == sorted(known)
    assert [float(value) for value in orders["descending"] if value != "–"] == known[::-1]
    assert all(order[len(known) :] == ["–"] * (len(before) - len(known)) for order in list(orders.values())[:2])
    assert column(tab, table, 0) == before


def test_the_command_of_the_controller_to_take_is_copied(browser: Chromium, report: Report, tmp_path: Path) -> None:
    assert report.transfer is not None
    known = replace(
        report,
        controllers={report.transfer.pick or "": "controllers/best.json"},
        settings={**report.settings, "robot": "emulated_car"},
    )
    tab = opened(browser, save_report(known, tmp_path)[1])
    tab.to_front()
    tab.call("Browser.grantPermissions", permissions=["clipboardReadWrite", "clipboardSanitizedWrite"])
    tab.click(".command button")
    tab.wait_for("document.querySelector('.command button').textContent === 'Copied'")
    command = "sysid-evo drive --controller controllers/best.json --robot emulated_car"
    assert tab.evaluate("document.querySelector('.command code').textContent") == command
    assert tab.evaluate("navigator.clipboard.readText()") == command


def test_nothing_went_wrong_in_the_page(tab: Tab) -> None:
    assert tab.evaluate("faults") == []


def test_without_a_script_lines_and_tables_are_there_and_no_button(browser: Chromium, page: Path) -> None:
    tab = browser.open("about:blank")
    tab.call("Emulation.setScriptExecutionDisabled", value=True)
    tab.call("Page.navigate", url=page.as_uri())
    tab.wait_for("document.readyState === 'complete' && document.querySelector('.unplayed') !== null")
    assert shown(tab, "[data-series]") > 10
    assert tab.evaluate("document.querySelectorAll('main button:not(.deck button)').length") == 0


def test_heads_of_tables_are_printed_again_on_the_next_page(browser: Chromium, page: Path) -> None:
    """A button in a head that is printed again is left out, so that heads are text in print."""
    tab = opened(browser, page)
    tab.call("Emulation.setEmulatedMedia", media="print")
    style = "getComputedStyle(document.querySelector('{}')).{}"
    assert tab.evaluate(style.format("thead", "breakInside")) == "avoid"
    assert tab.evaluate(style.format("thead th", "position")) == "static"
    assert tab.evaluate("document.querySelector('thead th button') !== null")
    assert tab.evaluate(style.format("thead th button", "display")) == "contents"
