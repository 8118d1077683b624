"""The page of a report in a real browser: for everyone, on a desk, a phone and paper, and read with the pointer.

axe-core is that of the package ``axe-core-python``, or a newer one where ``AXE_CORE`` says.
"""

import csv
import html
import os
import re
from dataclasses import replace
from itertools import pairwise
from xml.etree import ElementTree

import numpy as np
import pytest
from axe_core_python.sync_playwright import Axe
from playwright.sync_api import expect

from evaluation.plot_style import LINES, PAPER
from evaluation.report.report import save_report
from evaluation.report.study import save_study
from tests.fixtures import reports as chosen
from tests.fixtures.browser import DESK, PHONE, TABLET, resize, seen, share_of, shown, sideways
from tests.fixtures.known_models import Known, Sliding, fitted
from tests.fixtures.session import without_figures
from tests.fixtures.studies import made_up

LONG = "a_family_with_a_very_long_name_indeed+and_another_of_the_same_length"
SHEET = 718
"""CSS pixels across a sheet of A4 within its margins."""
HORIZON, FREE_RUN = "Error over the horizon", "Simulated and measured"


@pytest.fixture(scope="module")
def pages(report_page, tmp_path_factory):
    """The page of a run, of one with a long name in it, and of a study."""
    folder = tmp_path_factory.mktemp("pages")
    long = chosen.make_report({LONG: fitted(Known()), "sliding": fitted(Sliding())})
    study = save_study(made_up(procedure=["recommended", "plain"]), folder)
    with without_figures():  # its tables are wide; figures are as wide in all pages
        return {"run": report_page, "long": save_report(long, folder)[1], "study": study[-1]}


def test_the_page_is_self_contained_and_names_every_model_and_controller(report, report_page):
    text = report_page.read_text()
    assert not re.search(r"""(?:src|href)\s*=\s*["'](?!data:|\#)""", text)
    assert set(re.findall(r"https?://[^\"]*", text)) == {"http://www.w3.org/2000/svg"}  # a name, never fetched
    assert "@import" not in text
    scripts = re.findall(r"<script([^>]*)>", text)  # data, and the script of the page: nothing that is fetched
    data = {f' type="application/json" {name}' for name in ('id="replay-data"', 'class="chart"', 'class="links"')}
    assert {script for script in scripts if script} == data
    assert scripts.count("") == 1
    for name in (*report.prediction.names, *report.matrix.rows, *report.matrix.columns):
        assert html.escape(name) in text
    assert text.index("Which models predict?") < text.index("Error over the horizon")


@pytest.mark.parametrize("which", ["run", "study"])
def test_axe_finds_nothing_and_a_page_is_printed_on_several_sheets(visitor, pages, which):
    axe = Axe.from_file(os.environ["AXE_CORE"]) if "AXE_CORE" in os.environ else Axe()
    page = visitor.open(pages[which])
    page.evaluate(axe.axe_script)
    contrast = {"runOnly": {"type": "rule", "values": ["color-contrast"]}}  # it takes most of the time
    others = {"rules": {"color-contrast": {"enabled": False}}}
    for width, scheme, rules in ((DESK, "light", {}), (DESK, "dark", contrast), (PHONE, "light", others)):
        resize(page, width)
        page.emulate_media(color_scheme=scheme)
        options = {"resultTypes": ["violations"], **rules}
        found = page.evaluate("options => axe.run(document, options).then(found => found.violations)", options)
        assert [f"{one['id']}: {one['nodes'][0]['html']}" for one in found] == [], (width, scheme)
    pdf = page.pdf(format="A4", print_background=True)
    assert pdf.startswith(b"%PDF")
    sheets = sum(pdf.count(mark) for mark in (b"/Type /Page\n", b"/Type /Page ", b"/Type/Page"))
    assert sheets >= {"run": 4, "study": 2}[which]


@pytest.mark.parametrize("which", ["long", "study"])
def test_the_page_is_as_wide_as_the_screen_and_what_is_wider_scrolls_in_itself(visitor, pages, which):
    page = visitor.open(pages[which])
    for width in (320, PHONE, TABLET, DESK):
        resize(page, width)
        assert sideways(page) == 0, width
        assert page.evaluate("innerWidth") == width
    if which == "long":
        resize(page, PHONE)
        tables = page.locator("section > .scroll").filter(visible=True)
        assert max(tables.evaluate_all("all => all.map(e => e.scrollWidth - e.clientWidth)")) > 50
        overflow, attachment = tables.first.evaluate(
            "e => [getComputedStyle(e).overflowX, getComputedStyle(e).backgroundAttachment]"
        )
        assert overflow == "auto"
        assert attachment == "local, local, scroll, scroll"  # its edge is shaded


def test_the_colours_follow_the_theme_of_the_reader(page):
    resize(page, DESK, 2600)
    light = seen(page)
    page.emulate_media(color_scheme="dark")
    dark = seen(page)
    assert share_of(PAPER.light, light) > 0.5
    assert share_of(PAPER.dark, dark) > 0.5
    blue = LINES[0]  # of the lines of plots alone
    assert share_of(blue.light, light) > 1e-4
    assert share_of(blue.dark, dark) > 1e-4
    assert share_of(blue.light, dark) < 1e-5


def test_a_phone_gets_the_drawings_made_for_it(page):
    assert (shown(page, ".on-wide > svg") > 0, shown(page, ".on-narrow > svg")) == (True, 0)
    resize(page, PHONE)
    assert sideways(page) == 0
    assert (shown(page, ".on-wide > svg"), shown(page, ".on-narrow > svg") > 0) == (0, True)


def test_labels_of_the_plots_are_large_enough_to_read(page):
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


def test_the_drawings_have_ink_all_the_way_down_and_nothing_sticks_out_of_the_column(page):
    resize(page, DESK, 6000)
    inked = seen(page).min(axis=2) < 0.5
    assert np.count_nonzero(inked.sum(axis=1)) > 1500
    assert not inked[:, 1200:].any()


def test_headings_go_down_one_level_at_a_time(page):
    levels = page.locator("h1, h2, h3, h4").evaluate_all("all => all.map(e => Number(e.tagName[1]))")
    assert levels[0] == 1
    assert all(after - before <= 1 for before, after in pairwise(levels))


def test_paper_gets_no_buttons_and_no_player_and_heads_of_tables_again_on_the_next_page(page):
    """A button in a head that is printed again is left out, so that heads are text in print."""
    resize(page, SHEET)
    page.emulate_media(media="print")
    for gone in (".deck", ".screens", "nav", ".tip", ".watch", ".command button"):
        assert shown(page, gone) == 0, gone
    assert shown(page, "figure svg") > 4
    assert sideways(page) == 0
    head = page.locator("thead").first
    expect(head).to_have_css("break-inside", "avoid")
    expect(head.locator("th").first).to_have_css("position", "static")
    expect(page.locator("thead th .sort").first).to_have_css("display", "contents")


def figure(page, title):
    return page.locator("figure").filter(has=page.get_by_role("heading", name=title, exact=True))


def hover(page, title, across, down):
    """Point at a place of a figure, in shares of its drawing, and return what the tip says."""
    plot = figure(page, title).locator(".read").filter(visible=True).first
    left, top, width, height = plot.evaluate(
        "plot => { plot.scrollIntoView({block: 'center'}); const box = plot.getBoundingClientRect();"
        " return [box.left, box.top, box.width, box.height]; }"
    )
    page.mouse.move(left + across * width, top + down * height)
    return figure(page, title).locator(".tip").filter(visible=True).inner_text()


def rows_of(tip):
    """Return value and interval by the name of the series."""
    rows = [line.strip().split("\t") for line in tip.splitlines() if "\t" in line]
    return {row[0]: row[1:] for row in rows}


def number(text):
    return float(text.replace("\u2212", "-"))


def column(table, place):
    cells = table.locator(f"tbody td:nth-child({place + 1}), tbody th:nth-child({place + 1})")
    return [text.split("\n")[0] for text in cells.all_inner_texts()]


@pytest.mark.parametrize("width", [PHONE, DESK])
def test_pointing_at_a_plot_shows_every_value_with_its_interval(page, report, width):
    resize(page, width)
    tip = hover(page, HORIZON, 0.6, 0.5)
    dt = report.prediction.cases.system.dt
    place = round(number(tip.split()[1]) / dt) - 1
    assert place > 5
    for name in ("weak", "sliding"):
        model, (value, interval) = report.prediction.model(name), rows_of(tip)[name]
        assert number(value) == pytest.approx(model.curve[place], rel=0.006)
        low, high = (number(end) for end in interval.split(" to "))
        assert (low, high) == pytest.approx(model.curve_interval[:, place], rel=0.006)
    assert list(rows_of(tip)) == sorted(rows_of(tip), key=lambda name: -number(rows_of(tip)[name][0]))
    box = figure(page, HORIZON).locator(".tip").filter(visible=True).bounding_box()
    assert 0 <= box["x"] < box["x"] + box["width"] <= width


def test_pointing_at_a_controller_shows_what_it_claims_and_achieves(page, report):
    first = next(one for one in report.transfer.controllers if one.claimed and one.elsewhere)
    sentence = page.locator('.first .plot [data-link="0"] title').first.text_content() or ""
    assert sentence.startswith(f"{first.name}: claims ")
    assert ", measured on car " in sentence


def test_pointing_at_a_row_of_a_study_shows_the_mean_of_each_group_with_its_interval(visitor, pages):
    page = visitor.open(pages["study"])
    tip = hover(page, "Achieved fitness", 0.6, 0.1)
    assert tip.splitlines()[0]
    assert all(0.0 < number(value[0]) < 2.0 for value in rows_of(tip).values())
    assert rows_of(tip)


def test_a_model_that_is_switched_off_is_hidden_in_every_plot_of_its_section_and_comes_back(page):
    series = ('[data-series="1"]', '[data-series="2"]')
    before = [shown(page, one) for one in series]
    buttons = page.locator('section:has(> #prediction) .legend li[data-name="known"] button')
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


def test_the_arrow_keys_read_a_plot_aloud(page):
    plot = figure(page, FREE_RUN).locator(".read").first
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


def test_a_table_sorts_by_the_column_whose_head_is_clicked_and_back(page):
    table, place = page.locator("table.sorts").first, 1
    before = column(table, 0)
    head = table.locator("thead tr").first.locator("th, td").nth(place)
    orders = {}
    for expected in ("ascending", "descending", None):
        head.get_by_role("button").click()
        assert head.get_attribute("aria-sort") == expected
        orders[expected] = column(table, place)
    known = [number(value.split()[0]) for value in orders["ascending"] if value != "–"]
    assert known == sorted(known)
    assert [number(value.split()[0]) for value in orders["descending"] if value != "–"] == known[::-1]
    assert all(order[len(known) :] == ["–"] * (len(before) - len(known)) for order in list(orders.values())[:2])
    assert column(table, 0) == before


@pytest.fixture(scope="module")
def large_page(tmp_path_factory):
    return save_report(chosen.large_report(), tmp_path_factory.mktemp("large"))[1]


def test_a_report_of_seven_models_and_eleven_controllers_is_short_and_begins_with_its_answers(visitor, large_page):
    page = visitor.open(large_page)
    assert page.evaluate("document.documentElement.scrollHeight") <= 10_000
    assert page.evaluate("document.querySelector('.answers').getBoundingClientRect().top") < 120
    assert page.evaluate("document.querySelector('table').getBoundingClientRect().top") < 950
    assert page.get_by_role("heading", level=1).inner_text() == "emulated_car, point_to_point: 7 models, 8 controllers"
    links = page.locator("nav a").all_inner_texts()
    order = "Controllers, Replay, Trust, Prediction, Models, Next recording, Behaviour, Data, This run"
    assert ", ".join(links) == order


@pytest.mark.parametrize("width", [PHONE, DESK])
def test_the_name_and_the_column_of_the_robot_stay_in_view(visitor, large_page, width):
    page = visitor.open(large_page)
    resize(page, width)
    scroll = page.locator(".scroll").filter(has_text="evolved3").first
    scroll.evaluate("e => { e.style.maxWidth = '500px'; }")
    # the place of the second column follows the width of the first in the frame after
    page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    before, after = [], []
    for found, left in ((before, 0), (after, 120)):
        scroll.evaluate("(e, left) => { e.scrollLeft = left; }", left)
        cells = scroll.locator("tbody tr").first.locator("th, td")
        found += [cells.nth(place).bounding_box()["x"] for place in (0, 1, 4)]
    assert after[:2] == pytest.approx(before[:2], abs=1.0)
    assert after[2] == pytest.approx(before[2] - 120.0, abs=1.0)


def test_a_click_on_a_dot_plays_that_controller(visitor, large_page):
    page = visitor.open(large_page)
    dot = page.locator('.first .plot [data-link="4"]').first
    dot.dispatch_event("click")
    expect(page.locator("#replay-row")).to_have_value("evolved3")
    expect(page.locator("#replay-play")).to_have_text("Pause")
    name = page.locator('.first .plot [role="button"][data-link="5"]')
    expect(name).to_have_accessible_name(re.compile("^Watch nearest_neighbour: claims 12.00 "))
    name.press("Enter")
    expect(page.locator("#replay-row")).to_have_value("nearest_neighbour")


def test_a_word_is_explained_by_a_click_on_its_question_mark(page):
    explained = page.get_by_role("button", name="What is: forecast").first
    meaning = page.locator(f"#{explained.get_attribute('popovertarget')}")
    expect(meaning).to_be_hidden()
    explained.click()
    expect(meaning).to_be_visible()
    expect(meaning).to_contain_text("Expected fitness on the robot")
    page.keyboard.press("Escape")
    expect(meaning).to_be_hidden()


def test_tables_and_figures_are_saved_by_a_click(page, report):
    with page.expect_download() as saved:
        page.get_by_role("button", name="Save as CSV: Simulation error N").click()
    assert saved.value.suggested_filename == "simulation-error-n-95-intervals.csv"
    rows = list(csv.reader(saved.value.path().read_text("utf-8-sig").splitlines()))
    assert rows[0][:2] == ["model", "1 step (0.05 s)"]
    assert [row[0].split()[0] for row in rows[1:]] == list(report.prediction.names)
    assert {len(row) for row in rows} == {len(rows[0])}
    with page.expect_download() as saved:
        page.get_by_role("button", name=f"Save as SVG: {HORIZON}").click()
    drawing = saved.value.path().read_text()
    assert ElementTree.fromstring(drawing).tag.endswith("svg")
    assert "var(--" not in drawing
    assert all(f">{name}<" in drawing for name in report.prediction.names)


def test_a_reader_chooses_the_test_episode(page):
    shown = figure(page, FREE_RUN)
    select = shown.get_by_label("Test episode")
    names = [shown.locator(".read").filter(visible=True).get_attribute("aria-label")]
    select.select_option(index=1)
    names.append(shown.locator(".read").filter(visible=True).get_attribute("aria-label"))
    assert len(set(names)) == 2
    select.select_option(index=0)


def test_the_command_of_the_controller_to_take_is_copied(visitor, tmp_path):
    fitness = {"a": {"a": 10.0, "b": 9.0, "emulated_car": 9.5}, "b": {"a": 3.0, "b": 9.5, "emulated_car": 5.0}}
    made = chosen.report(transfer=chosen.matrix(fitness, robot="emulated_car"))
    files = {made.transfer.pick: "controllers/best.json"}
    known = replace(made, controllers=files, settings={"robot": "emulated_car"})
    page = visitor.open(save_report(known, tmp_path)[1], permissions=["clipboard-read", "clipboard-write"])
    command = page.locator(".command").first
    command.get_by_role("button").click()
    expect(command.get_by_role("button")).to_have_text("Copied")
    text = "sysid-evo drive --controller controllers/best.json --robot emulated_car"
    expect(command.locator("code")).to_have_text(text)
    assert page.evaluate("navigator.clipboard.readText()") == text


def test_without_a_script_lines_and_tables_are_there_no_button_and_a_word_on_what_is_missing(visitor, report_page):
    page = visitor.open(report_page, java_script_enabled=False)
    assert shown(page, "[data-series]") > 10
    expect(page.locator("main button:not(.deck button, .help)")).to_have_count(0)
    expect(page.locator(".unplayed")).to_contain_text("needs JavaScript")
    assert shown(page, "#replay-player") == 0
