"""The page of `sysid-evo drive`: who may open it, what losing it means to the robot, and what driving leaves behind."""

import json
import os
import re
import signal
import socket
import sys
import threading
import time
import urllib.error
import urllib.request
from contextlib import ExitStack, contextmanager, suppress
from urllib.parse import urlsplit

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

import hardware
from evaluation.experiment import FILE, Experiment
from evaluation.transfer.matrix import load_measured, transfer_seeds
from hardware.connection import GateLimits
from hardware.driving import server
from hardware.driving.hand_driving import HandPanel, HandTrial, hand_trials
from hardware.driving.keyboard import HOLD, Keyboard, key_validity
from hardware.driving.page_messages import FORWARD, LEFT, Phase
from hardware.driving.server import PageAddress, PageServer, check_page
from hardware.emulation.simulated_robot import in_real_time
from hardware.emulation.tracked_robots import ModelRobot
from hardware.recording.journal import read_journal
from hardware.run_report import LoopReport, StopReason, StopRequest
from sysid_evo.cli.robots import DriveTarget, add_row, drive_by_hand
from sysid_evo.data import Dataset, Trajectory
from sysid_evo.errors import InvalidArgument, MissingExtra
from sysid_evo.registry import make_robot
from sysid_evo.tasks import PointToPoint
from tests.fixtures.loop import Diary
from tests.fixtures.robots import store_champion
from tests.fixtures.waiting import wait_until

EVERY = 0.025  # s


class Desk:
    """A robot, the page to drive it, and what a session needs."""

    def __init__(self):
        self.robot = in_real_time(make_robot("emulated_car"))
        self.task = PointToPoint(horizon=200).bind(self.robot.system)
        self.keyboard = Keyboard(life=key_validity(self.robot.system))
        self.instruments = HandPanel(self.robot, self.task, self.keyboard)
        self.deaths = []
        self.page = PageServer(
            self.instruments, self.keyboard, host="127.0.0.1", port=0, on_server_end=self.deaths.append
        )


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


def talk(url, *, origin="ours"):
    base = urlsplit(url)
    origin = f"http://{base.netloc}" if origin == "ours" else origin
    return connect(f"ws://{base.netloc}{base.path}socket", origin=origin, compression=None, max_queue=None)


def say(line, keys):
    line.send(json.dumps({"type": "keys", "keys": keys, "clock": time.monotonic(), "new_trial": False}))


def drain(line):
    while True:
        line.recv(timeout=5.0)


def test_the_page_and_its_files_are_there_for_who_knows_the_address(desk):
    scripts = ((f"{name}.js", "javascript") for name in ("drive", "messages", "plot", "traces", "view"))
    for name, kind in (("", "html"), ("drive.css", "css"), *scripts):
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
        with pytest.raises(InvalidStatus), talk(desk.page.url, origin=origin):
            pass
    assert status_of(desk.page.url, Origin="http://evil.example") == 403
    with talk(desk.page.url) as line:
        assert json.loads(line.recv(timeout=5.0))["robot"] == "emulated_car"


def test_connections_without_the_secret_keep_nobody_out_and_are_closed(monkeypatch):
    monkeypatch.setattr(server, "SILENCE", 0.5)
    monkeypatch.setattr(server, "MOST_SILENT", 50)
    desk = Desk()
    base = urlsplit(desk.page.url)
    with desk.page, ExitStack() as stack:
        lines = [
            stack.enter_context(socket.create_connection((base.hostname or "", base.port or 0))) for _ in range(60)
        ]
        with talk(desk.page.url) as page:
            assert json.loads(page.recv(timeout=5.0))["robot"] == "emulated_car"
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
        pages = [stack.enter_context(talk(desk.page.url)) for _ in range(server.MOST_CONNECTIONS)]
        for page in pages:
            page.recv(timeout=5.0)
        assert status_of(desk.page.url) == 503
        pages[0].close()
        wait_until(lambda: status_of(desk.page.url) == 200)


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
    for nonsense, reason in (
        ("{", "Expecting property name"),
        ('{"keys": 1}', "expected a message of the type keys with keys, clock, new_trial"),
        ('["' + "\N{SNOWMAN}" * 60 + '"]', "expected a message"), (b"\x00", "expected text, got bytes"),
        ("x" * 1000, ""),
    ):  # fmt: skip
        with talk(desk.page.url) as line:
            line.send(nonsense)
            with pytest.raises(ConnectionClosed) as closed:
                drain(line)
            assert closed.value.rcvd.reason.startswith(reason)
    assert status_of(desk.page.url) == 200


def test_one_page_drives_and_the_next_takes_over_when_it_goes(desk):
    def drives(line):
        return json.loads(line.recv(timeout=5.0)).get("is_driver", False)

    with talk(desk.page.url) as watcher_to_be:
        wait_until(lambda: drives(watcher_to_be))
        with talk(desk.page.url) as other:
            other.recv(timeout=5.0)
            assert not drives(other)
            watcher_to_be.close()
            wait_until(lambda: drives(other))


def test_a_port_that_is_taken_is_told_in_a_sentence(desk):
    port = urlsplit(desk.page.url).port
    with pytest.raises(InvalidArgument, match=f"port {port}"):
        PageServer(desk.instruments, desk.keyboard, host="127.0.0.1", port=port or 0, on_server_end=desk.deaths.append)


def test_losing_the_server_releases_the_keys_and_is_reported():
    desk = Desk()
    desk.keyboard.press(FORWARD)
    desk.page._server.should_exit = True
    wait_until(lambda: bool(desk.deaths))
    assert desk.keyboard.keys == 0
    assert "server" in desk.deaths[0]
    desk.page.close()


class Typist:
    """A page that drives forward, run by the session's own calls, until it is lost in some way.

    ``gap`` is the longest time between two of its messages, which a busy machine makes longer than `EVERY`.
    """

    def __init__(self, desk, stops, lose):
        self.desk, self.stops, self.lose = desk, stops, lose
        self.lost = self.gap = 0.0

    def type(self):
        with talk(self.desk.page.url) as line:
            drives_since, said = None, time.monotonic()
            while not self.lost:
                phase = self.desk.instruments.reading().phase
                say(line, FORWARD if phase in (Phase.READY, Phase.DRIVING) else 0)
                self.gap, said = max(self.gap, time.monotonic() - said), time.monotonic()
                if phase is Phase.DRIVING:
                    drives_since = drives_since or time.monotonic()
                    if time.monotonic() - drives_since > 0.5:
                        self.lost = time.monotonic()
                        self.lose(line)
                        break
                time.sleep(EVERY)
            time.sleep(0.6)
            self.stops.request(StopReason.SIGTERM)


@pytest.mark.parametrize(
    "lose",
    [lambda line: line.socket.close(), lambda line: line.close(), lambda line: None, lambda line: say(line, 0)],
    ids=["the connection breaks", "the page is closed", "the page is silent", "the key is released"],
)
def test_losing_the_page_means_neutral_within_150_ms(desk, lose):
    stops, diary = StopRequest(), Diary()
    typist = Typist(desk, stops, lose)
    thread = threading.Thread(target=typist.type)
    driving = hand_trials(
        desk.robot, desk.task, desk.keyboard, desk.instruments,
        seed_of=lambda index: index, stop=stops, recorder=lambda *_: diary,
    )  # fmt: skip
    thread.start()
    trials = list(driving)
    thread.join()
    assert [trial.fitness for trial in trials] == [None]
    driven = [command.time for command in diary.commands if command.control.any()]
    late = max(0.0, float(trials[0].report.gaps.max()) - desk.robot.system.dt)
    assert typist.lost - 0.15 - late - typist.gap < driven[-1]
    neutral = min(command.time for command in diary.commands if command.time > driven[-1])
    assert neutral <= typist.lost + HOLD + late


SECONDS = 1.5


class Page(threading.Thread):
    """Opens the page as a browser does, keeps what it is told, and holds two keys ``until`` then, given seconds."""

    def __init__(self, url, until=None, *, interrupt=False):
        super().__init__()
        self.told, self.url, self.until, self.interrupt = [], url, until, interrupt
        self.start()

    def run(self):
        with talk(self.url) as line, suppress(ConnectionClosed):
            self.look(line)
        if self.interrupt:
            os.kill(os.getpid(), signal.SIGINT)

    def look(self, line):
        began = 0.0
        while True:
            reading = json.loads(line.recv(timeout=20.0))
            self.told.append(reading)
            if self.until is None or "phase" not in reading:
                continue
            say(line, FORWARD | LEFT if reading["phase"] in ("ready", "driving") else 0)
            began = began or (time.monotonic() if reading["phase"] == "driving" else 0.0)
            if began and self.until(time.monotonic() - began):
                return


@pytest.fixture
def pages(monkeypatch):
    """A function that says how the page is used once `drive --open` opens it; it returns the list of opened pages."""
    found = []

    def used(until=None, *, interrupt=False):
        monkeypatch.setattr("webbrowser.open", lambda url: found.append(Page(url, until, interrupt=interrupt)))
        return found

    return used


def test_what_is_driven_becomes_a_data_set_that_inspect_reads(call, pages):
    pages(lambda seconds: seconds > SECONDS, interrupt=True)
    done = call("drive", "--out", "mine", "--open")
    assert done.code == StopReason.SIGINT.exit_code, done.stderr
    assert done.stdout.startswith("Drive emulated_car at http://127.0.0.1:")
    assert "data set stored in mine" in done.stdout
    dataset = Dataset.read(call.folder / "mine")
    assert 0.5 * SECONDS < dataset.duration < SECONDS + 2.0
    assert dataset.system.control_names == ("drive", "steer")
    assert dataset.episodes[0].states[:, 0].max() > 1.0
    assert dataset.episodes[0].states[-1, 2] > 1.0
    assert (call.folder / "mine" / "journal" / "trial-1.rcj").is_file()
    inspected = call.told("inspect", "mine", "--json")
    assert inspected["episodes"][0]["name"] == "trial-1"


def test_a_model_is_recorded_in_the_same_way(call, run_copy, pages):
    pages(lambda seconds: seconds > 0.5, interrupt=True)
    done = call("drive", "--model", "linear", "--run", "out", "--out", "felt", "--open")
    assert done.code == StopReason.SIGINT.exit_code, done.stderr
    assert done.stdout.startswith("Drive linear at http://127.0.0.1:")
    episode = Dataset.read(call.folder / "felt").episodes[0]
    assert {tuple(control) for control in episode.controls} >= {(1.0, 1.0)}
    assert np.ptp(episode.states[:, 0]) > 0.1
    assert read_journal(call.folder / "felt/journal/trial-1.rcj").limits.speed == np.inf


@pytest.mark.nightly
def test_whole_trials_become_a_row_of_the_matrix(call, pages):
    (call.folder / "runs/a/models").mkdir(parents=True)
    pages(lambda seconds: False)
    done = call.works("drive", "--run", "runs/a", "--name", "human", "--trials", "1", "--open")
    ((measured,), _) = load_measured(call.folder / "runs/a")
    assert (measured.cell.champion, measured.cell.column) == ("human", "emulated_car driven")
    assert f"trial 1: {measured.cell.fitness[0]:g} waypoints" in done.stdout


@pytest.mark.parametrize(
    ("robot", "task"),
    [("pendulum", "track_reference(horizon=10)"), ("emulated_car", "point_to_point(horizon=10)")],
)
def test_who_opens_the_page_of_a_controller_sees_every_trial(robot, task, pages, call):
    store_champion(robot, task, call.folder)
    opened = pages()
    done = call.works("drive", "--robot", robot, "--controller", "mine", "--trials", "2", "--open")
    assert re.search(r"Watch it at http://127.0.0.1:\S+ \(driving begins when the page is open\)\n", done.stdout)
    (page,) = opened
    page.join(10.0)
    setting, scenery, *readings = page.told
    assert (setting["robot"], scenery["type"]) == (robot, "scenery")
    steps = {(reading["trial"], reading["step"]) for reading in readings if reading.get("phase") == "driving"}
    assert {1, 2} <= {trial for trial, _ in steps}
    assert len(steps) > 12
    assert readings[-1]["phase"] == "finished"
    assert len(readings[-1]["scores"]) == 2


def trial(number, fitness):
    system = make_robot("emulated_car").system
    task = PointToPoint().bind(system)
    state = task.begin(np.array([number], dtype=np.uint64))
    trajectory = Trajectory(np.zeros((3, 3)), np.zeros((2, 2)), system.dt, np.zeros((3, 3)), f"trial-{number}")
    report = LoopReport(StopReason.PILOT, "", np.zeros(2), np.zeros(1))
    return HandTrial(number, f"trial-{number}", number, fitness, trajectory, state, report, GateLimits())


@pytest.mark.parametrize(("asked", "seed"), [(None, 7), (0, 0), (5, 5)])
def test_trials_by_hand_are_the_fresh_trials_of_the_run_or_of_the_seed(asked, seed, tmp_path, monkeypatch):
    found = []

    @contextmanager
    def page(*_, seed_of, **__):
        found.extend(map(seed_of, range(3)))
        yield iter(())

    monkeypatch.setattr(hardware, "driven_by_hand", page)
    Experiment(seed=7).write(tmp_path / FILE)
    driven = DriveTarget(make_robot("emulated_car"), "car", tmp_path, on_robot=True)
    drive_by_hand(driven, PageAddress(), None, None, asked, tracker_origin=False)
    assert found == transfer_seeds(seed, 3).tolist()


def test_only_trials_driven_to_their_end_count_in_the_row(tmp_path):
    robot = ModelRobot("linear", make_robot("emulated_car").dynamics)
    driven = DriveTarget(robot, "linear", tmp_path, on_robot=False)
    add_row(driven, tmp_path, "humFc", [trial(1, None)])
    assert load_measured(tmp_path) == ((), ())
    add_row(driven, tmp_path, "humFc", [trial(1, 7.0), trial(2, None), trial(3, 9.0)])
    ((measured,), _) = load_measured(tmp_path)
    assert measured.cell.fitness.tolist() == [7.0, 9.0]
    assert (measured.cell.champion, measured.cell.column, measured.cell.unit) == ("humFc", "linear", "waypoints")
    assert (measured.on_robot, measured.physical, measured.champion.against) == (False, False, ())
    assert len(measured.cell.traces) == 2
    assert measured.cell.traces[0].waypoints.shape == (1, 2)


def test_a_page_that_cannot_be_served_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    with pytest.raises(MissingExtra, match=r"driving by hand needs the package 'uvicorn'.*sysid-evo\[drive\]"):
        check_page()
