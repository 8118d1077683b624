"""The page of driving in a real browser: keys move the car, losing the page stops it, a controller is shown."""

import json
import threading
import time
from contextlib import contextmanager, suppress
from dataclasses import replace

import numpy as np
import pytest
from playwright.sync_api import Error, expect

from hardware.connection import Listener
from hardware.driving.controller_driving import ControllerPanel, readings
from hardware.driving.hand_driving import HandPanel, hand_trials
from hardware.driving.keyboard import HOLD, Keyboard, key_validity
from hardware.driving.page_messages import Phase, as_text, keys_message
from hardware.driving.server import PageServer
from hardware.emulation.simulated_robot import in_real_time
from hardware.run_report import StopReason, StopRequest
from sysid_evo.registry import make_robot
from sysid_evo.tasks import PointToPoint
from tests.fixtures.browser import seen, sideways
from tests.fixtures.panels import SEEDS, simulated

BANNER = "document.getElementById('banner').textContent"
READY = f"{BANNER}.startsWith('Press')"
LOST = f"{BANNER}.includes('R starts another trial')"
SPEED = "Number(document.getElementById('speed').textContent)"


class Heard(Keyboard):
    """A keyboard that knows when, and how often, the page said that a key is down."""

    last = 0.0
    words = 0

    def press(self, keys):
        super().press(keys)
        if keys:
            self.last = time.monotonic()
            self.words += 1


class Session(Listener):
    """A session of driving by hand in a thread; ``sent`` are the commands of the trials."""

    def __init__(self, horizon):
        self.robot = in_real_time(make_robot("emulated_car"))
        task = PointToPoint(horizon=horizon).bind(self.robot.system)
        self.keyboard = keyboard = Heard(life=key_validity(self.robot.system))
        self.sent = []
        self.trials = []
        self.stops = StopRequest()
        instruments = HandPanel(self.robot, task, keyboard)
        self.page = PageServer(instruments, keyboard, host="127.0.0.1", port=0, on_server_end=lambda _: None)
        options = {"seed_of": lambda index: index, "stop": self.stops, "recorder": lambda *_: self}
        self._driving = hand_trials(self.robot, task, keyboard, instruments, **options)
        self._thread = threading.Thread(target=self._drive)
        self._thread.start()

    def on_command(self, command):
        self.sent.append(command)

    def end(self):
        self.stops.request(StopReason.SIGTERM)
        self._thread.join()
        self.page.close()

    def neutral_since(self):
        """Return when the first neutral command after the last other one was sent."""
        driven = max(command.time for command in self.sent if command.control.any())
        return min(command.time for command in self.sent if command.time > driven)

    def slack(self):
        """Return by how much (s) a busy machine has kept the loop waiting."""
        sent = np.array([command.time for command in self.sent])
        return max(0.0, float(np.diff(sent).max()) - self.robot.system.dt)

    def _drive(self):
        for trial in self._driving:
            self.trials.append(trial)


@contextmanager
def driving(horizon):
    session = Session(horizon)
    try:
        yield session
    finally:
        session.end()


@pytest.fixture
def session():
    with driving(400) as session:
        yield session


@pytest.fixture
def page(session, visitor):
    page = visitor.open(session.page.url)
    wait_until_ready(page)
    return page


def wait_until_ready(page):
    """Wait until a key would start a trial; a machine that is busy with other tests loses the robot now and then."""
    for _ in range(10):
        wait(page, f"{READY} || {LOST}")
        if page.evaluate(READY):
            return
        page.keyboard.press("KeyR")
    pytest.fail("the robot was lost ten times before a trial began")


def wait(page, condition):
    """Wait for what is true in the page in some frame; a function needs no ``eval``, which the page does not allow."""
    page.wait_for_function(f"() => {condition}")


def until(condition):
    """Wait for what is true in this process in some moment."""
    deadline = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_an_arrow_key_down_and_up_moves_the_car_and_stops_it(session, page):
    page.keyboard.down("ArrowUp")
    wait(page, f"{SPEED} > 0.8")
    page.keyboard.up("ArrowUp")
    released = time.monotonic()
    wait(page, f"{SPEED} < 0.02")
    assert session.keyboard.last < released + HOLD
    assert session.neutral_since() < session.keyboard.last + HOLD + session.slack()
    driven = {tuple(command.control) for command in session.sent}
    assert driven == {(0.0, 0.0), (1.0, 0.0)}


def lose_by_closing(page):
    page.close()


def lose_by_freezing(page):
    """Its scripts stand still, but nobody closes its line."""
    debugger = page.context.new_cdp_session(page)
    debugger.send("Debugger.enable")
    debugger.send("Debugger.pause")


def lose_by_hiding(page):
    page.evaluate("Object.defineProperty(document, 'hidden', {value: true})")
    page.evaluate("document.dispatchEvent(new Event('visibilitychange')), 0")


def lose_the_focus(page):
    page.evaluate("window.dispatchEvent(new Event('blur')), 0")


def press_space(page):
    page.keyboard.press("Space")


def lose_by_crashing(page):
    with page.expect_event("crash"), suppress(Error):
        page.goto("chrome://crash")


@pytest.mark.parametrize(
    "lose", [lose_by_closing, lose_by_freezing, lose_by_hiding, lose_the_focus, press_space, lose_by_crashing]
)
def test_losing_the_page_stops_the_car(session, page, lose):
    page.keyboard.down("ArrowUp")
    wait(page, f"{SPEED} > 0.5")
    heard = session.keyboard.words
    until(lambda: session.keyboard.words > heard)
    before = time.monotonic()
    lose(page)
    until(lambda: time.monotonic() > session.keyboard.last + 0.3)
    until(lambda: not session.sent[-1].control.any())
    assert before - HOLD - session.slack() < session.keyboard.last
    assert session.neutral_since() < session.keyboard.last + HOLD + session.slack()
    assert len(session.sent) > 10


def test_r_begins_a_new_trial_and_a_held_key_does_not_start_it(session, page):
    page.keyboard.down("ArrowUp")
    wait(page, f"{SPEED} > 0.5")
    number = int(page.locator("#trial").inner_text().split()[1])
    page.keyboard.press("KeyR")
    expect(page.locator("#trial")).to_have_text(f"trial {number + 1}")
    driven, heard = sum(command.control.any() for command in session.sent), session.keyboard.words
    wait(page, f"{BANNER}.startsWith('Release')")
    until(lambda: session.keyboard.words > heard + 30)
    assert page.evaluate(f"{BANNER}.startsWith('Release')")
    assert sum(command.control.any() for command in session.sent) == driven
    assert [trial.fitness for trial in session.trials] == [None] * number
    page.keyboard.up("ArrowUp")
    wait(page, READY)
    page.keyboard.down("KeyW")
    wait(page, f"{SPEED} > 0.5")


def test_the_buttons_on_the_page_drive_while_they_are_touched(session, visitor):
    page = visitor.open(session.page.url, width=400, is_mobile=True)
    wait_until_ready(page)
    page.get_by_label("backward").hover()
    page.mouse.down()
    wait(page, f"{SPEED} < -0.5")
    page.mouse.move(300, 100)
    page.mouse.up()
    wait(page, f"{SPEED} > -0.02")
    assert {tuple(command.control) for command in session.sent} == {(0.0, 0.0), (-1.0, 0.0)}


def test_a_second_page_watches(session, page, visitor):
    other = visitor.page()
    with other.expect_websocket() as opened:
        other.goto(session.page.url)
    wait(other, f"{BANNER}.startsWith('Watching')")
    line = opened.value
    with line.expect_event("framesent", lambda said: json.loads(said)["keys"] == 1):
        other.keyboard.down("ArrowUp")
    for _ in range(15):  # what the server tells in 0.3 s
        line.wait_for_event("framereceived")
    assert not session.sent


PLACES = """all => all.map(part => {
  const { x, y, right, bottom } = part.getBoundingClientRect();
  return [x, y, right, bottom].map(Math.round);
})"""


BLUE, ORANGE, GREY = (0x00, 0x72, 0xB2), (0xD5, 0x5E, 0x00), (0x8D, 0x98, 0xA5)


def count(pixels, colour, off):
    return int((np.abs(pixels - np.array(colour) / 255.0).max(axis=2) < off).sum())


@pytest.mark.parametrize("size", [(1280, 800), (400, 700), (900, 560)])
def test_everything_fits_and_nothing_moves_while_the_figures_change(visitor, size):
    width, height = size
    with driving(30) as session:
        page = visitor.open(session.page.url, width=width, height=height)
        parts = page.locator("#scene, header, dl, #pad, #again")
        wait_until_ready(page)
        places = [parts.evaluate_all(PLACES)]
        page.keyboard.down("ArrowUp")
        for moment in (f"{SPEED} > 0.5", f"{BANNER}.startsWith('Trial over')"):
            wait(page, moment)
            places.append(parts.evaluate_all(PLACES))
        pixels = seen(page)
        page.close()
    assert places[0] == places[1] == places[2]
    for left, top, right, bottom in places[0]:
        assert 0 <= left < right <= width
        assert 0 <= top < bottom <= height
    assert count(pixels, BLUE, off=0.03) > 60  # the car
    assert count(pixels, ORANGE, off=0.03) > 100  # its goal
    assert [trial.fitness for trial in session.trials[:-1]] == [None] * (len(session.trials) - 1)
    assert session.trials[-1].fitness is not None


@pytest.mark.parametrize(
    ("spec", "robot", "size"),
    [
        pytest.param("set_point(channels=temperature, horizon=30)", "thermal", (1280, 800), id="one state, desk"),
        pytest.param("swing_up(horizon=30)", "pendulum", (375, 667), id="two states, phone"),
    ],
)
def test_the_page_draws_the_states_beside_their_targets_and_offers_no_keys(visitor, spec, robot, size):
    task, rollouts = simulated(spec, robot)
    panel = ControllerPanel(robot, task, "best")
    shown, scene = readings(task, SEEDS[:1], rollouts.trajectories[0], 1), task.scene(task.begin(SEEDS[:1]), 0)
    panel.show(shown[0], scene)
    with PageServer(panel, Keyboard(life=1.0), host="127.0.0.1", port=0, on_server_end=print) as server:
        page = visitor.open(server.url, width=size[0], height=size[1])
        expect(page.locator("#banner")).to_have_text("best drives")
        before = seen(page)
        for reading in shown[1:-1:4]:
            panel.show(reading, scene)
            left = (30 - reading.step) * task.system.dt
            wait(page, f"Math.abs(Number(document.getElementById('time').textContent) - {left}) < 0.06")
        pixels = seen(page)
        assert count(pixels, BLUE, off=0.15) > count(before, BLUE, off=0.15) + 50
        assert count(pixels, GREY, off=0.15) > 100
        assert sideways(page) == 0
        expect(page.locator("#pad")).to_be_hidden()
        expect(page.locator("#view")).to_be_hidden()
        panel.show(replace(shown[-1], phase=Phase.FINISHED, score=12.345), scene)
        expect(page.locator("#banner")).to_have_text("Trial over, score 12.35.")
        page.close()


@pytest.mark.parametrize(
    ("where", "says", "sentence"),
    [
        ("server.as_text", lambda _: '{"type": "weather"}', "The server sends an unknown message: weather"),
        ("server.as_text", lambda said: as_text(said).replace('"score": 0.0', '"score": null'),
         "reading: expected score as number, got null"),
        ("keyboard.keys_message", lambda said: keys_message({**said, "keys": 16}),
         "The server rejects the messages of this page: keys: expected 0 to 15, got 16"),
    ],
)  # fmt: skip
def test_a_wrong_message_ends_the_conversation_and_the_page_says_why(visitor, monkeypatch, where, says, sentence):
    monkeypatch.setattr(f"hardware.driving.{where}", says)
    task, _ = simulated("swing_up(horizon=30)", "pendulum")
    panel, keyboard = ControllerPanel("pendulum", task, "best"), Keyboard(life=1.0)
    with PageServer(panel, keyboard, host="127.0.0.1", port=0, on_server_end=print) as server:
        page = visitor.open(server.url)
        expect(page.locator("#banner")).to_have_text(sentence)
        expect(page.locator("#page")).to_have_text("not connected")
        page.close()
