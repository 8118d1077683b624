"""The replay in a real browser: it plays, pauses and scrubs, on a desk and on a phone."""

import io
import re
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.image import imread
from playwright.sync_api import expect

from evaluation.plot_style import LINES
from evaluation.report.report import save_report
from evaluation.transfer.matrix import Trace
from sysid_evo.data import Trajectory
from sysid_evo.tasks import Target
from sysid_evo.testing.examples import drone
from tests.fixtures.browser import DESK, PHONE, TABLET, resize, share_of, sideways
from tests.fixtures.known_models import SYSTEM
from tests.fixtures.session import without_figures

CLOCK, PLAY, TIME, ROW, PACE = "#replay-clock", "#replay-play", "#replay-time", "#replay-row", "#replay-pace"
FRAMES = "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => requestAnimationFrame(done))))"


@pytest.fixture(scope="module")
def states_page(report, tmp_path_factory):
    """The page of a system without a pose, whose first state had a target."""
    cells = {}
    for key, cell in report.matrix.cells.items():
        target = Target(SYSTEM.states[0], 0, np.array([0.4]), 0.1)
        traces = tuple(
            replace(trace, trajectory=replace(trace.trajectory, pose=None), targets=(target,)) for trace in cell.traces
        )
        cells[key] = replace(cell, traces=traces)
    states = replace(report, prediction=None, exploitability=(), matrix=replace(report.matrix, cells=cells))
    with without_figures():
        return save_report(states, tmp_path_factory.mktemp("page"))[1]


@pytest.fixture(scope="module")
def space_page(report, tmp_path_factory):
    """The page of a body that climbs a helix, past a waypoint."""
    phase, system = np.linspace(0.0, 6.0, 61), drone()
    pose = np.zeros((61, 7))
    pose[:, :3] = np.stack([2.0 * np.sin(phase), 1.0 - np.cos(phase), phase], axis=1)
    pose[:, 3] = 1.0
    run = Trajectory(np.zeros((61, 9)), np.zeros((60, 4)), system.dt, pose=pose)
    trace = Trace(run, 1.0, pose[[20, 60], :3], 0.2)
    cells = {key: replace(cell, traces=(trace,)) for key, cell in report.matrix.cells.items()}
    champions = tuple(replace(champion, system=system) for champion in report.matrix.champions)
    matrix = replace(report.matrix, cells=cells, champions=champions)
    flown = replace(report, prediction=None, exploitability=(), matrix=matrix)
    with without_figures():
        return save_report(flown, tmp_path_factory.mktemp("page"))[1]


@pytest.fixture
def page(page):
    """The page with its replay at the start, as it is when opened."""
    if page.locator(PLAY).text_content() == "Pause":
        page.locator(PLAY).click()
    page.locator(ROW).select_option("known_c")
    page.locator(PACE).select_option("1")
    seek(page, 0.0)
    return page


def seek(page, seconds):
    page.locator(TIME).fill(str(seconds))


def painted(page):
    """Return what the first screen shows (height, width, 3), from 0 to 1."""
    picture = page.locator(".screen canvas").first.screenshot()
    return np.asarray(imread(io.BytesIO(picture))[:, :, :3])


def test_there_is_a_screen_for_every_system_with_a_frame_for_the_robot(page):
    page.locator(ROW).select_option("ensemble_c")
    names = page.locator(".screen .name").evaluate_all("all => all.map(e => e.firstChild.textContent)")
    assert names == ["car", "known", "weak", "sliding"]
    expect(page.locator(".screen.robot")).to_have_count(1)
    told = page.locator(".screen small").all_text_contents()
    assert "evolved here" not in told[0]
    assert "matches the robot to the end" in told[1]
    assert "evolved here" in told[2]
    assert "matches the robot for " in told[2]


def test_another_controller_is_shown_when_it_is_chosen(page):
    for row in ("sliding_c", "known_c"):
        page.locator(ROW).select_option(row)
        expect(page.locator(".screen canvas").first).to_have_attribute("aria-label", re.compile(f"^{row} on car"))


def test_the_path_so_far_is_drawn_in_the_colours_of_the_theme(page):
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        coloured = []
        for seconds in (0.0, 2.9):
            seek(page, seconds)
            pixels = painted(page)
            path = pixels[: pixels.shape[1]]  # above the bars of the controls
            coloured.append(sum(share_of(getattr(colour, scheme), path) for colour in LINES[:2]))
        assert coloured[0] < 1e-5 < 3e-5 < coloured[1], scheme  # a line of a few dozen pixels


def test_it_plays_to_the_end_pauses_and_starts_again(page):
    play, clock = page.locator(PLAY), page.locator(CLOCK)
    page.locator(PACE).select_option("0.25")
    play.click()
    expect(play).to_have_text("Pause")
    page.wait_for_function(f"() => Number(document.querySelector('{TIME}').value) > 0.1")
    play.click()
    expect(play).to_have_text("Play")
    stood = clock.text_content()
    page.evaluate(FRAMES)
    assert clock.text_content() == stood
    page.locator(PACE).select_option("10")
    play.click()
    expect(play).to_have_text("Play")
    expect(clock).to_have_text("3.0 s")  # 60 steps of 0.05 s
    page.locator(PACE).select_option("0.25")
    play.click()
    expect(play).to_have_text("Pause")
    assert float(page.locator(TIME).input_value()) < 2.0


def test_it_scrubs_with_the_pointer_and_with_the_keys(page):
    slider, clock = page.locator(TIME), page.locator(CLOCK)
    slider.scroll_into_view_if_needed()
    now = page.locator(".screen .now").first
    drawn, told = [painted(page)], [now.text_content()]
    box = slider.bounding_box()
    y, seconds = box["y"] + box["height"] / 2, []
    page.mouse.move(box["x"] + 0.1 * box["width"], y)
    page.mouse.down()
    for across in (0.3, 0.9, 0.5):
        page.mouse.move(box["x"] + across * box["width"], y)
        seconds.append(float((clock.text_content() or "").split()[0]))
    page.mouse.up()
    assert seconds == pytest.approx([0.9, 2.7, 1.5], abs=0.15)  # of 3 s
    drawn.append(painted(page))
    told.append(now.text_content())
    assert (drawn[0] != drawn[1]).any()
    assert told[0] != told[1]
    slider.press("ArrowRight")
    slider.press("ArrowRight")
    expect(clock).to_have_text(f"{seconds[-1] + 0.1:.1f} s")  # two steps
    slider.press("Home")
    expect(clock).to_have_text("0.0 s")


def test_it_goes_by_a_step_with_buttons_and_keys(page):
    seek(page, 1.0)
    time = page.locator(TIME)
    back, on = (page.get_by_role("button", name=f"One step {way}") for way in ("back", "forward"))
    for button, value in ((on, "1.05"), (on, "1.1"), (back, "1.05")):
        button.click()
        expect(time).to_have_value(value)
    for key, value in ((".", "1.1"), (",", "1.05"), (",", "1")):
        page.locator(PLAY).press(key)
        expect(time).to_have_value(value)
    time.press("Home")
    time.press(",")
    expect(time).to_have_value("0")
    page.locator(PACE).select_option("0.25")
    time.press(" ")
    expect(page.locator(PLAY)).to_have_text("Pause")
    time.press(".")  # whoever goes by steps wants to look
    expect(page.locator(PLAY)).to_have_text("Play")


def test_all_systems_are_shown_on_request_and_a_phone_shows_the_robot_and_one_model(page):
    page.locator(ROW).select_option("ensemble_c")
    screens, beside = page.locator(".screen"), page.locator("#replay-beside")
    counts = []
    for _ in range(3):
        counts.append(screens.evaluate_all("all => all.filter(e => e.clientWidth).length"))
        page.locator("#replay-all").click()
    page.locator("#replay-all").click()
    assert counts == [3, 4, 3]  # the robot and the models of the evolution, then every system
    expect(beside).to_be_hidden()
    resize(page, PHONE)
    for name in ("known", "sliding"):
        beside.select_option(name)
        told = screens.evaluate_all(
            "all => all.filter(e => e.clientWidth).map(e => [e.querySelector('.name').firstChild.textContent, "
            "Math.round(e.getBoundingClientRect().top), e.querySelector('canvas').height > 0])"
        )
        assert [(column, drawn) for column, _, drawn in told] == [("car", True), (name, True)]
        assert told[0][1] == told[1][1]


def test_what_plays_goes_on_from_where_it_is_scrubbed_to(page):
    page.locator(PACE).select_option("0.25")
    page.locator(PLAY).click()
    seek(page, 2.0)
    page.wait_for_function(
        f"() => Number(document.querySelector('{TIME}').value) > 2.05"
        f" && document.querySelector('{PLAY}').textContent === 'Pause'"
    )


def test_a_card_shows_its_controller_and_a_button_where_it_parts_from_the_robot(page):
    page.locator('.watch[data-row="sliding_c"] button').first.click()
    expect(page.locator(ROW)).to_have_value("sliding_c")
    expect(page.locator(PLAY)).to_have_text("Pause")
    page.locator("#replay-all").click()
    page.locator(".screen button").filter(visible=True).first.click()
    expect(page.locator(PLAY)).to_have_text("Play")
    there = page.locator(".screen").filter(has=page.get_by_role("button")).filter(visible=True).first
    expect(there).to_contain_text(f"matches the robot for {page.locator(CLOCK).text_content()}")
    page.locator("#replay-all").click()


def test_every_control_has_a_name_for_those_who_cannot_see_it(page):
    controls = page.locator(".deck select, .deck input")
    assert controls.evaluate_all("all => all.map(e => e.labels.length)") == [1, 1, 1, 1]
    for canvas in page.locator(".screen canvas").filter(visible=True).all():
        expect(canvas).to_have_role("img")
        expect(canvas).to_have_accessible_name(re.compile("."))
    seek(page, 1.0)
    expect(page.locator(TIME)).to_have_attribute("aria-valuetext", "1.0 s")


def widest(page):
    """Return by how much the page, and the widest part of the replay, stand out at any width of the screen."""
    out = []
    for width in (320, PHONE, TABLET, DESK):
        resize(page, width)
        parts = page.locator(".deck > *, .screen").evaluate_all("all => all.map(e => e.scrollWidth - e.clientWidth)")
        out += [sideways(page), *parts]
    return max(out)


def test_the_replay_is_never_wider_than_the_screen(page):
    assert widest(page) == 0


def test_states_are_drawn_over_time_with_their_value_now_in_three_digits_of_their_range(visitor, states_page, report):
    page = visitor.open(states_page)
    expect(page.locator(ROW)).to_have_value(report.transfer.pick)
    now = page.locator(".screen .now").first
    for step in range(0, 60, 7):
        seek(page, 0.05 * step)
        for number in re.findall(r"\d*\.\d+", now.text_content() or ""):
            assert len(number.partition(".")[2]) <= 3, number
    seek(page, 1.0)
    name, unit = SYSTEM.states[0].name, SYSTEM.states[0].unit
    expect(now).to_have_text(re.compile(f"^{name} .*{unit}$"))
    assert share_of(LINES[0].light, painted(page)) > 1e-3
    assert widest(page) == 0


def test_a_body_in_space_is_drawn_from_above_and_from_the_side_and_its_waypoints_count_in_height(visitor, space_page):
    page = visitor.open(space_page)
    seek(page, 1.2)
    box = page.locator(".screen canvas").first.bounding_box()
    assert 2.0 * box["width"] < box["height"] < 2.6 * box["width"]
    shown = painted(page)
    above, side = shown[: shown.shape[1]], shown[shown.shape[1] : 2 * shown.shape[1]]
    for half in (above, side):
        assert share_of(LINES[0].light, half) + share_of(LINES[1].light, half) > 1e-3
    now = page.locator(".screen .now").first
    expect(now).to_have_text(re.compile("2 passed"))
    seek(page, 0.2)
    expect(now).to_have_text(re.compile("m/s, 0 passed"))
