"""The page's server: who may open it, and what losing it means to the robot."""

from __future__ import annotations

import json
import socket
import threading
import time
import urllib.error
import urllib.request
from contextlib import ExitStack, suppress
from urllib.parse import urlsplit

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from hardware.connection import Command, Listener
from hardware.driving import server
from hardware.driving.hand_driving import HandDriving, Instruments, Phase
from hardware.driving.keyboard import HOLD, Keyboard, key_life
from hardware.driving.page_messages import FORWARD
from hardware.driving.server import PageServer
from hardware.emulation.simulated_robot import in_real_time
from hardware.robot import Robot
from hardware.run_report import Reason, Stops
from sysid_evo.errors import InvalidArgument
from sysid_evo.registry import make_robot
from sysid_evo.tasks import PointToPoint

EVERY = 0.025  # s


class Desk:
    """A robot, the page to drive it, and what a session needs."""

    def __init__(self):
        self.robot: Robot = in_real_time(make_robot("emulated_car"))
        self.task = PointToPoint(horizon=200).bind(self.robot.system)
        self.keyboard = Keyboard(life=key_life(self.robot.system))
        self.instruments = Instruments(self.robot, self.task, self.keyboard)
        self.deaths: list[str] = []
        self.page = PageServer(self.instruments, self.keyboard, host="127.0.0.1", port=0, died=self.deaths.append)


@pytest.fixture(scope="module")
def desk():
    desk = Desk()
    with desk.page:
        yield desk
    assert not desk.deaths


def status_of(url, **headers):
    try:
        with urllib.request.urlopen(urllib.request.Request(url, headers=headers), timeout=10.0) as answer:
            return answer.status
    except urllib.error.HTTPError as error:
        with error:
            return error.code


def talk(desk, *, origin="ours", **headers):
    base = urlsplit(desk.page.url)
    origin = f"http://{base.netloc}" if origin == "ours" else origin
    address = f"ws://{base.netloc}{base.path}socket"
    return connect(address, origin=origin, additional_headers=headers, compression=None, max_queue=None)


def say(line, keys, **more):
    line.send(json.dumps({"keys": keys, "clock": time.monotonic(), **more}))


def drain(line):
    while True:
        line.recv(timeout=5.0)


def wait_for(condition, timeout=10.0):
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.002)


def test_the_page_and_its_files_are_there_for_who_knows_the_address(desk):
    for name, kind in (("", "html"), ("drive.js", "javascript"), ("view.js", "javascript"), ("drive.css", "css")):
        with urllib.request.urlopen(desk.page.url + name, timeout=10.0) as answer:
            assert kind in answer.headers["Content-Type"]
            assert answer.headers["Content-Security-Policy"].startswith("default-src 'none'")
            text = answer.read().decode()
        assert "http://" not in text
        assert "https://" not in text


def test_without_the_token_nothing_is_there(desk):
    base = urlsplit(desk.page.url)
    token = base.path.strip("/")
    assert len(token) >= 20
    for path in ("/", "/drive.js", f"/{token}", f"/{token[:-1]}/", f"/{token}x/", "//", f"/x/{token}/", "/%ff/"):
        assert status_of(f"http://{base.netloc}{path}") == 403, path
    assert status_of(desk.page.url + "..%2fserver.py") == 404
    with (
        pytest.raises(InvalidStatus),
        connect(f"ws://{base.netloc}/{token[:-1]}/socket", origin=f"http://{base.netloc}"),
    ):
        pass


@pytest.mark.parametrize(
    ("host", "status"),
    [("evil.example", 403), ("evil.example:80", 403), ("127.0.0.1.evil.example", 403), ("[", 403),
     ("localhost:1", 200), ("127.0.0.1", 200), ("[::1]:80", 200)],
)  # fmt: skip
def test_a_name_that_was_pointed_at_this_machine_is_refused(desk, host, status):
    assert status_of(desk.page.url, Host=host) == status


def test_another_page_may_not_open_the_socket(desk):
    for origin in ("http://evil.example", "null", None):
        with pytest.raises(InvalidStatus), talk(desk, origin=origin):
            pass
    assert status_of(desk.page.url, Origin="http://evil.example") == 403
    with talk(desk) as line:
        assert json.loads(line.recv(timeout=5.0))["setting"]["robot"] == "emulated_car"


def test_connections_without_the_secret_keep_nobody_out_and_are_closed(monkeypatch):
    monkeypatch.setattr(server, "SILENCE", 0.5)
    monkeypatch.setattr(server, "MOST_SILENT", 50)
    desk = Desk()
    base = urlsplit(desk.page.url)
    with desk.page, ExitStack() as stack:
        lines = [
            stack.enter_context(socket.create_connection((base.hostname or "", base.port or 0))) for _ in range(60)
        ]
        with talk(desk) as page:
            assert json.loads(page.recv(timeout=5.0))["setting"]["robot"] == "emulated_car"
            assert status_of(desk.page.url) == 200
            refused = lines.pop()
            refused.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")
            refused.settimeout(5.0)
            assert b"".join(iter(lambda: refused.recv(1000), b"")).startswith(b"HTTP/1.1 403")
            assert gone(lines[0])  # too many: the oldest makes room
            assert not gone(lines[-1])
            since = time.monotonic()
            while not all(map(gone, lines)):
                with suppress(OSError):
                    lines[-1].sendall(b"G")  # slow is as good as silent
                time.sleep(0.05)
                assert time.monotonic() < since + 5.0
            time.sleep(0.6)
            page.recv(timeout=5.0)
        pages = [stack.enter_context(talk(desk)) for _ in range(server.MOST_CONNECTIONS)]
        for page in pages:
            page.recv(timeout=5.0)
        assert status_of(desk.page.url) == 503
        pages[0].close()
        wait_for(lambda: status_of(desk.page.url) == 200)


def gone(line):
    """Whether the other side has closed this connection."""
    line.settimeout(0.001)
    try:
        return not line.recv(1)
    except TimeoutError:
        return False
    except OSError:
        return True


def test_nonsense_ends_the_conversation(desk):
    for nonsense in ("{", "[]", '{"keys": 1}', "x" * 1000, b"\x00"):
        with talk(desk) as line:
            line.send(nonsense)
            with pytest.raises(ConnectionClosed):
                drain(line)
    assert status_of(desk.page.url) == 200


def test_one_page_drives_and_the_next_takes_over_when_it_goes(desk):
    def drives(line):
        return json.loads(line.recv(timeout=5.0)).get("drives", False)

    with talk(desk) as watcher_to_be:
        wait_for(lambda: drives(watcher_to_be))
        with talk(desk) as other:
            other.recv(timeout=5.0)
            assert not drives(other)
            watcher_to_be.close()
            wait_for(lambda: drives(other))


def test_a_port_that_is_taken_is_told_in_a_sentence(desk):
    port = urlsplit(desk.page.url).port
    with pytest.raises(InvalidArgument, match=f"port {port}"):
        PageServer(desk.instruments, desk.keyboard, host="127.0.0.1", port=port or 0, died=desk.deaths.append)


def test_losing_the_server_releases_the_keys_and_is_reported():
    desk = Desk()
    desk.keyboard.press(FORWARD)
    desk.page._server.should_exit = True
    wait_for(lambda: bool(desk.deaths))
    assert desk.keyboard.keys == 0
    assert "server" in desk.deaths[0]
    desk.page.close()


class Commands(Listener):
    def __init__(self):
        self.sent: list[Command] = []

    def commanded(self, command):
        self.sent.append(command)


class Typist:
    """A page that drives forward, run by the session's own calls, until it is lost in some way."""

    def __init__(self, desk, stops, lose):
        self.desk, self.stops, self.lose = desk, stops, lose
        self.lost = 0.0

    def type(self):
        with talk(self.desk) as line:
            drives_since = None
            while not self.lost:
                phase = self.desk.instruments.reading()["phase"]
                say(line, FORWARD if phase in (Phase.READY.value, Phase.DRIVING.value) else 0)
                if phase == Phase.DRIVING.value:
                    drives_since = drives_since or time.monotonic()
                    if time.monotonic() - drives_since > 0.5:
                        self.lost = time.monotonic()
                        self.lose(line)
                        break
                time.sleep(EVERY)
            time.sleep(0.6)
            self.stops.request(Reason.SIGTERM)


@pytest.mark.parametrize(
    "lose",
    [lambda line: line.socket.close(), lambda line: line.close(), lambda line: None, lambda line: say(line, 0)],
    ids=["the connection breaks", "the page is closed", "the page is silent", "the key is released"],
)
def test_losing_the_page_means_neutral_within_150_ms(desk, lose):
    stops, commands = Stops(), Commands()
    typist = Typist(desk, stops, lose)
    thread = threading.Thread(target=typist.type)
    driving = HandDriving(
        desk.robot, desk.task, desk.keyboard, desk.instruments,
        seed_of=lambda index: index, stops=stops, recorder=lambda *_: commands,
    )  # fmt: skip
    thread.start()
    trials = list(driving.trials())
    thread.join()
    assert [trial.fitness for trial in trials] == [None]
    driven = [command.time for command in commands.sent if command.control.any()]
    assert typist.lost - 0.15 < driven[-1]
    neutral = min(command.time for command in commands.sent if command.time > driven[-1])
    late = max(0.0, float(trials[0].report.gaps.max()) - desk.robot.system.dt)
    assert neutral <= typist.lost + HOLD + late
