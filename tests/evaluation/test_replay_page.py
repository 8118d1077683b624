"""The replay in a real browser: it plays, pauses and scrubs, on a desk and on a phone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from evaluation.plots.theme import LINES
from evaluation.report import save_report
from sysid_evo.tasks import Target
from tests.chromium import Chromium, Tab, find_chromium
from tests.evaluation.known_models import SYSTEM, Known, Sliding, fitted
from tests.evaluation.test_report import make_report

PHONE, DESK = 375, 1280
CLOCK = "document.getElementById('replay-clock').textContent"
NOTED = """
window.faults = [];
addEventListener('error', (event) => faults.push(event.message));
const said = console.error;
console.error = (...words) => { faults.push(words.join(' ')); said(...words); };
"""


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chromium]:
    with Chromium(find_chromium(), tmp_path_factory.mktemp("profile")) as browser:
        yield browser


@pytest.fixture(scope="module")
def tab(browser: Chromium, tmp_path_factory: pytest.TempPathFactory) -> Tab:
    """The page of a car: its faults are noted from the start."""
    _, page = save_report(
        make_report({"known": fitted(Known()), "sliding": fitted(Sliding())}), folder(tmp_path_factory)
    )
    return opened(browser, page)


@pytest.fixture(scope="module")
def states(browser: Chromium, tmp_path_factory: pytest.TempPathFactory) -> Tab:
    """The page of a system without a pose, whose first state had a target."""
    report = make_report({"known": fitted(Known())})
    assert report.matrix is not None
    cells = {}
    for key, cell in report.matrix.cells.items():
        target = Target(SYSTEM.states[0], 0, np.array([0.4]), 0.1)
        traces = tuple(
            replace(trace, trajectory=replace(trace.trajectory, pose=None), targets=(target,)) for trace in cell.traces
        )
        cells[key] = replace(cell, traces=traces)
    _, page = save_report(replace(report, matrix=replace(report.matrix, cells=cells)), folder(tmp_path_factory))
    return opened(browser, page)


def folder(factory: pytest.TempPathFactory) -> Path:
    return factory.mktemp("page")


def opened(browser: Chromium, page: Path) -> Tab:
    tab = browser.open("about:blank")
    tab.call("Page.addScriptToEvaluateOnNewDocument", source=NOTED)
    tab.call("Page.navigate", url=page.as_uri())
    tab.wait_for("document.readyState === 'complete' && document.querySelectorAll('.screen').length > 0")
    tab.call("Emulation.setDeviceMetricsOverride", width=DESK, height=800, deviceScaleFactor=1, mobile=False)
    return tab


def seek(tab: Tab, seconds: float) -> None:
    tab.evaluate(
        "(() => { const slider = document.getElementById('replay-time');"
        f" slider.value = {seconds}; slider.dispatchEvent(new Event('input')); }})()"
    )


def painted(tab: Tab, file: Path, *, dark: bool = False) -> np.ndarray:
    """Return what the first screen shows (height, width, 3), from 0 to 1."""
    tab.evaluate("document.querySelector('.screens').scrollIntoView()")
    tab.picture(file, width=DESK, height=800, dark=dark)
    left, top, right, bottom = tab.evaluate(
        "(() => { const box = document.querySelector('.screen canvas').getBoundingClientRect();"
        " return [box.left, box.top, box.right, box.bottom].map(Math.round); })()"
    )
    return np.asarray(imread(file)[max(top, 0) : bottom, left:right, :3])


def share_of(colour: str, pixels: np.ndarray) -> float:
    wanted = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
    return float((np.abs(pixels - wanted).max(axis=2) < 0.02).mean())


def choose(tab: Tab, row: str) -> None:
    tab.evaluate(
        f"(() => {{ const row = document.getElementById('replay-row'); row.value = '{row}';"
        " row.dispatchEvent(new Event('change')); })()"
    )


def test_a_screen_for_every_system_the_robot_in_a_frame(tab: Tab) -> None:
    assert tab.evaluate("document.getElementById('replay-row').value") == "known_c"  # the one to take
    choose(tab, "ensemble_c")
    names = "[...document.querySelectorAll('.screen .name')].map(e => e.firstChild.textContent)"
    assert tab.evaluate(names) == ["car", "known", "sliding"]
    assert tab.evaluate("document.querySelectorAll('.screen.robot').length") == 1
    told = tab.evaluate("[...document.querySelectorAll('.screen small')].map(e => e.textContent)")
    assert "evolved here" not in told[0]
    assert "as on the robot to the end" in told[1]
    assert "evolved here" in told[2]
    assert "as on the robot for " in told[2]


def test_another_controller_is_shown_when_it_is_chosen(tab: Tab) -> None:
    for row in ("sliding_c", "known_c"):
        choose(tab, row)
        assert tab.evaluate("document.querySelector('.screen canvas').ariaLabel").startswith(f"{row} on car")


@pytest.mark.parametrize("dark", [False, True])
def test_what_was_done_so_far_is_drawn_in_the_colours_of_the_theme(tab: Tab, tmp_path: Path, dark: bool) -> None:
    coloured = []
    for seconds in (0.0, 2.9):
        seek(tab, seconds)
        pixels = painted(tab, tmp_path / "page.png", dark=dark)
        path = pixels[: pixels.shape[1]]  # above the bars of the controls
        coloured.append(sum(share_of(getattr(colour, "dark" if dark else "light"), path) for colour in LINES[:2]))
    assert coloured[0] < 1e-5 < 3e-5 < coloured[1]  # a line of a few dozen pixels


def test_it_plays_to_the_end_pauses_and_begins_anew(tab: Tab) -> None:
    tab.to_front()
    seek(tab, 0.0)
    tab.evaluate("document.getElementById('replay-pace').value = '1'; document.getElementById('replay-play').click()")
    assert tab.evaluate("document.getElementById('replay-play').textContent") == "Pause"
    tab.wait_for("Number(document.getElementById('replay-time').value) > 0.2")
    tab.evaluate("document.getElementById('replay-play').click()")
    stood = tab.evaluate("document.getElementById('replay-clock').textContent")
    tab.evaluate("new Promise(done => setTimeout(done, 200))")
    assert tab.evaluate("document.getElementById('replay-clock').textContent") == stood
    assert tab.evaluate("document.getElementById('replay-play').textContent") == "Play"
    tab.evaluate("document.getElementById('replay-pace').value = '10'; document.getElementById('replay-play').click()")
    tab.wait_for("document.getElementById('replay-play').textContent === 'Play'")
    assert tab.evaluate("document.getElementById('replay-clock').textContent") == "3.0 s"  # 60 steps of 0.05 s
    tab.evaluate("document.getElementById('replay-play').click()")
    assert float(tab.evaluate("document.getElementById('replay-time').value")) < 1.0
    tab.evaluate("document.getElementById('replay-play').click()")


def test_a_card_shows_its_controller_and_a_button_where_it_parts_from_the_robot(tab: Tab) -> None:
    tab.to_front()
    watched = "[...document.querySelectorAll('.watch')].find(e => e.dataset.row === 'sliding_c').firstElementChild"
    tab.evaluate(f"{watched}.click()")
    assert tab.evaluate("document.getElementById('replay-row').value") == "sliding_c"
    assert tab.evaluate("document.getElementById('replay-play').textContent") == "Pause"
    tab.click(".screen button")
    assert tab.evaluate("document.getElementById('replay-play').textContent") == "Play"
    there = tab.evaluate("[...document.querySelectorAll('.screen')].find(e => e.querySelector('button')).innerText")
    assert f"as on the robot for {tab.evaluate(CLOCK)}" in there


def test_states_are_drawn_over_time_with_their_value_now(states: Tab, tmp_path: Path) -> None:
    seek(states, 1.0)
    now = states.evaluate("document.querySelector('.screen .now').textContent")
    assert now.startswith(f"{SYSTEM.states[0].name} ")
    assert now.endswith(SYSTEM.states[0].unit)
    assert share_of(LINES[0].light, painted(states, tmp_path / "page.png")) > 1e-3


@pytest.mark.parametrize("width", [320, PHONE, 768, DESK])
@pytest.mark.parametrize("which", ["tab", "states"])
def test_the_replay_is_never_wider_than_the_screen(
    which: str, width: int, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    tab: Tab = request.getfixturevalue(which)
    tab.picture(tmp_path / "page.png", width=width, height=800)
    assert tab.evaluate("document.documentElement.scrollWidth") <= width
    assert (
        tab.evaluate(
            "Math.max(...[...document.querySelectorAll('.deck > *, .screen')].map(e => e.scrollWidth - e.clientWidth))"
        )
        <= 0
    )


def test_every_control_has_a_name_for_those_who_cannot_see_it(tab: Tab) -> None:
    labels = "[...document.querySelectorAll('.deck select, .deck input')].map(e => e.labels.length)"
    assert tab.evaluate(labels) == [1, 1, 1]
    assert tab.evaluate("[...document.querySelectorAll('.screen canvas')].every(e => e.role === 'img' && e.ariaLabel)")
    seek(tab, 1.0)
    assert tab.evaluate("document.getElementById('replay-time').getAttribute('aria-valuetext')") == "1.0 s"


def test_nothing_went_wrong_in_the_page(tab: Tab, states: Tab) -> None:
    assert tab.evaluate("faults") == []
    assert states.evaluate("faults") == []


def test_without_a_script_the_page_says_what_is_missing(browser: Chromium, tmp_path: Path) -> None:
    _, page = save_report(make_report({"known": fitted(Known())}), tmp_path)
    tab = browser.open("about:blank")
    tab.call("Emulation.setScriptExecutionDisabled", value=True)
    tab.call("Page.navigate", url=page.as_uri())
    tab.wait_for("document.readyState === 'complete' && document.querySelector('.unplayed') !== null")
    assert "needs JavaScript" in tab.evaluate("document.querySelector('.unplayed').textContent")
    assert tab.evaluate("document.getElementById('replay-player').getClientRects().length") == 0
