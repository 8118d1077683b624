"""The page in a real browser: keys move the car, and losing the page stops it."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from hardware.driving.instruments import Instruments
from hardware.driving.keyboard import HOLD, Keyboard, key_life
from hardware.driving.server import PageServer
from hardware.driving.session import HandDriving, HandTrial
from hardware.emulation.pacing import in_real_time
from hardware.listener import Command, Listener
from hardware.loop.report import Reason
from hardware.loop.stops import Stops
from sysid_evo.registry import make_robot
from sysid_evo.tasks import PointToPoint
from tests.chromium import Chromium, Tab, find_chromium

BANNER = "document.getElementById('banner').textContent"
READY = f"{BANNER}.startsWith('Press')"
SPEED = "Number(document.getElementById('speed').textContent)"


class Heard(Keyboard):
    """A keyboard that knows when the page last said that a key is down."""

    last = 0.0

    def press(self, keys: int) -> None:
        super().press(keys)
        if keys:
            self.last = time.monotonic()


class Session(Listener):
    """A session of driving by hand in a thread; ``sent`` are the commands of the trials."""

    def __init__(self, *, horizon: int) -> None:
        self.robot = in_real_time(make_robot("emulated_car"))
        task = PointToPoint(horizon=horizon).bind(self.robot.system)
        self.keyboard = keyboard = Heard(life=key_life(self.robot.system))
        self.sent: list[Command] = []
        self.trials: list[HandTrial] = []
        self.stops = Stops()
        instruments = Instruments(self.robot, task, keyboard)
        self.page = PageServer(instruments, keyboard, host="127.0.0.1", port=0, died=lambda _: None)
        self._driving = HandDriving(
            self.robot,
            task,
            keyboard,
            instruments,
            seed_of=lambda index: index,
            stops=self.stops,
            recorder=lambda *_: self,
        )
        self._thread = threading.Thread(target=self._drive)
        self._thread.start()

    def commanded(self, command: Command) -> None:
        self.sent.append(command)

    def end(self) -> None:
        self.stops.request(Reason.SIGTERM)
        self._thread.join()
        self.page.close()

    def neutral_since(self) -> float:
        """Return when the first neutral command after the last other one was sent."""
        driven = max(command.time for command in self.sent if command.control.any())
        return min(command.time for command in self.sent if command.time > driven)

    def slack(self) -> float:
        """Return by how much (s) a busy machine has kept the loop waiting."""
        sent = np.array([command.time for command in self.sent])
        return max(0.0, float(np.diff(sent).max()) - self.robot.system.dt)

    def _drive(self) -> None:
        for trial in self._driving.trials():
            self.trials.append(trial)


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chromium]:
    with Chromium(find_chromium(), tmp_path_factory.mktemp("chromium") / "profile") as chromium:
        yield chromium


@pytest.fixture
def session() -> Iterator[Session]:
    session = Session(horizon=400)
    yield session
    session.end()


@pytest.fixture
def tab(browser: Chromium, session: Session) -> Tab:
    tab = browser.open(session.page.url)
    tab.wait_for(READY)
    return tab


def test_an_arrow_key_down_and_up_moves_the_car_and_stops_it(session: Session, tab: Tab) -> None:
    tab.press("ArrowUp")
    tab.wait_for(f"{SPEED} > 0.8")
    released = time.monotonic()
    tab.release("ArrowUp")
    tab.wait_for(f"{SPEED} < 0.02")
    assert session.keyboard.last < released + HOLD
    assert session.neutral_since() < session.keyboard.last + HOLD + session.slack()
    driven = {tuple(command.control) for command in session.sent}
    assert driven == {(0.0, 0.0), (1.0, 0.0)}
    tab.close()


def lose_by_closing(tab: Tab) -> None:
    tab.close()


def lose_by_freezing(tab: Tab) -> None:
    tab.call("Page.setWebLifecycleState", state="frozen")


def lose_by_hiding(tab: Tab) -> None:
    tab.evaluate("Object.defineProperty(document, 'hidden', {value: true})")
    tab.evaluate("document.dispatchEvent(new Event('visibilitychange')), 0")


def lose_the_focus(tab: Tab) -> None:
    tab.evaluate("window.dispatchEvent(new Event('blur')), 0")


def press_space(tab: Tab) -> None:
    tab.press("Space")


def lose_by_crashing(tab: Tab) -> None:
    tab._line.send('{"id": 1000000, "method": "Page.crash"}')


@pytest.mark.parametrize(
    "lose", [lose_by_closing, lose_by_freezing, lose_by_hiding, lose_the_focus, press_space, lose_by_crashing]
)
def test_losing_the_page_stops_the_car(session: Session, tab: Tab, lose) -> None:
    tab.press("ArrowUp")
    tab.wait_for(f"{SPEED} > 0.5")
    before = time.monotonic()
    lose(tab)
    time.sleep(0.6)
    assert before - HOLD < session.keyboard.last < time.monotonic() - 0.3
    assert session.neutral_since() < session.keyboard.last + HOLD + session.slack()
    assert len(session.sent) > 10


def test_r_begins_a_new_trial_and_a_held_key_does_not_start_it(session: Session, tab: Tab) -> None:
    tab.press("ArrowUp")
    tab.wait_for(f"{SPEED} > 0.5")
    tab.press("KeyR")
    tab.wait_for("document.getElementById('trial').textContent === 'trial 2'")
    driven = sum(command.control.any() for command in session.sent)
    tab.wait_for(f"{BANNER}.startsWith('Release')")
    time.sleep(0.8)
    assert tab.evaluate(f"{BANNER}.startsWith('Release')")
    assert sum(command.control.any() for command in session.sent) == driven
    assert [trial.fitness for trial in session.trials] == [None]
    tab.release("ArrowUp")
    tab.wait_for(READY)
    tab.press("KeyW")
    tab.wait_for(f"{SPEED} > 0.5")
    tab.close()


def test_the_buttons_on_the_page_drive_while_they_are_touched(session: Session, tab: Tab) -> None:
    tab.call("Emulation.setDeviceMetricsOverride", width=400, height=800, deviceScaleFactor=1, mobile=True)
    x, y = tab.evaluate(
        "(() => { const r = document.querySelector('[data-key=\"2\"]').getBoundingClientRect();"
        " return [r.x + r.width / 2, r.y + r.height / 2]; })()"
    )
    tab.call("Input.dispatchMouseEvent", type="mousePressed", x=x, y=y, button="left", clickCount=1)
    tab.wait_for(f"{SPEED} < -0.5")
    tab.call("Input.dispatchMouseEvent", type="mouseReleased", x=300, y=100, button="left", clickCount=1)
    tab.wait_for(f"{SPEED} > -0.02")
    assert {tuple(command.control) for command in session.sent} == {(0.0, 0.0), (-1.0, 0.0)}
    tab.close()


def test_a_second_page_watches(session: Session, tab: Tab, browser: Chromium) -> None:
    other = browser.open(session.page.url)
    other.wait_for(f"{BANNER}.startsWith('Watching')")
    other.press("ArrowUp")
    time.sleep(0.3)
    assert not session.sent
    other.close()
    tab.close()


PLACES = """Array.from(document.querySelectorAll("#scene, header, dl, #pad, #again"), (part) => {
  const { x, y, right, bottom } = part.getBoundingClientRect();
  return [x, y, right, bottom].map(Math.round);
})"""


@pytest.mark.parametrize("size", [(1280, 800), (400, 700), (900, 560)])
def test_everything_fits_and_nothing_moves_while_the_figures_change(browser: Chromium, tmp_path: Path, size) -> None:
    session = Session(horizon=30)
    try:
        tab = browser.open(session.page.url)
        width, height = size
        tab.picture(tmp_path / "page.png", width=width, height=height)
        tab.wait_for(READY)
        places = [tab.evaluate(PLACES)]
        tab.press("ArrowUp")
        tab.wait_for(f"{SPEED} > 0.5")
        places.append(tab.evaluate(PLACES))
        tab.wait_for(f"{BANNER}.startsWith('Trial over')")
        places.append(tab.evaluate(PLACES))
        tab.picture(tmp_path / "page.png", width=width, height=height)
        pixels = imread(tmp_path / "page.png")[:, :, :3]
        tab.close()
    finally:
        session.end()
    assert places[0] == places[1] == places[2]
    for left, top, right, bottom in places[0]:
        assert 0 <= left < right <= width
        assert 0 <= top < bottom <= height
    car, goal = (np.array(colour) / 255.0 for colour in ((0x00, 0x72, 0xB2), (0xD5, 0x5E, 0x00)))
    assert (np.abs(pixels - car).max(axis=2) < 0.03).sum() > 60
    assert (np.abs(pixels - goal).max(axis=2) < 0.03).sum() > 100
    assert [trial.number for trial in session.trials] == [1]
    assert session.trials[0].fitness is not None
