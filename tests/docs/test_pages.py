"""README and pages: blocks in known languages, commands with their options, links, and Python that runs."""

import json
import os
import re
import shlex
import shutil
import socket
import subprocess
import sys
import threading
import time
import tomllib
from functools import cache
from importlib.util import find_spec

import numpy as np
import pandas as pd
import pytest

from hardware.connection import GateLimits
from hardware.control_loop import ControlLoop
from hardware.estimator import NewestPoseEstimator
from hardware.recording.manoeuvres import Manoeuvre
from hardware.recording.record import ManoeuvrePilot
from hardware.robot import find_robot
from hardware.run_report import StopReason
from hardware.trackers.udp import FrameMessage
from sysid_evo.cli.app import loaded
from sysid_evo.data import Dataset, load_columns
from sysid_evo.data.columns import parse_columns, shipped_names
from sysid_evo.engine import rollout
from sysid_evo.models.base import make_model
from sysid_evo.registry import load_plugin, robot_spec, robots
from sysid_evo.registry.registry import KINDS
from sysid_evo.tasks import PointToPoint
from sysid_evo.testing import check_model, example_dataset
from sysid_evo.testing.template import PLUGINS, write_plugin
from tests.docs.page import PAGES, ROOT
from tests.fixtures.commands import forgetting, run_here
from tests.system.rig.pose_stream import format_message

LANGUAGES = {"", "python", "toml", "sh", "py", "matlab"}
"""``py`` and ``matlab`` are other programs' and are not run: what is ours is ``python``."""
OTHER_PROGRAMS = {"make", "pip", "cd", "python3"}
VISITED = ("tutorials/", "your_own_system")
RUN = [page for name, page in PAGES.items() if page.blocks("python") and not name.startswith(VISITED)]
"""Pages whose Python is a program; the others are visited as a whole, see test_tutorials."""
SMALL_TASK = 'task="point_to_point(horizon=40)"'
SMALL = f'generations=1, trials=2, selection_trials=2, {SMALL_TASK}, strategy="mu_plus_lambda(parents=2, children=2)"'
COMPARISON = f"polish_generations=1, transfer_trials=2, traces=0, reference=False, {SMALL}"
KERNELS = ("damped", "damped_lifted", "damped_block")
"""The families of the page on kernels."""
BUDGETS = {
    "README.md": {
        "duration=120.0": "duration=20.0",
        '"sindy", "nearest': '"linear", "nearest',
        "generations=20, trials=4": SMALL,
    },
    "coming_from.md": {
        '"sindy": make_model("sindy")': '"sindy": make_model("linear")',
        "        generations=3,\n        trials=3,": f"\n        {SMALL},",
    },
    "bring_your_model.md": {
        **{
            block.text: "" for block in PAGES["bring_your_model.md"].blocks("python")[4:]
        },  # they take seconds to import
        '"narx", Hist': '"linear", Hist',
        '"narx", my_car], generations=20,': '"linear", my_car], stop_after="prediction",',
        "max_iter=50": "max_iter=5",
        " generations=20,": ' stop_after="prediction",',
    },
    "compare.md": {
        '    task="point_to_point(arena_radius=1.0)",': "",
        "    minutes=1.0,": "    minutes=0.3,",
        "    generations=3,": f"    {COMPARISON},",
    },
    "evolving.md": {
        "(generations=10, trials=4)": f"({SMALL})",
        "generations=12, trials=4, repeats=2": f"{SMALL}, repeats=2",
    },
    "grey_box.md": {"duration=60.0": "duration=20.0"},
    "gymnasium.md": {
        PAGES["gymnasium.md"].blocks("python")[-1].text: "",  # Stable-Baselines3, which takes seconds to import
        "horizon=100": "horizon=40",
        "duration=40.0": "duration=20.0",
        "generations=4,": "generations=1, strategy='mu_plus_lambda(parents=2, children=2)',",
        "selection_trials=10,": "selection_trials=2,",
    },
    "start.md": {'"sindy"': '"linear"', "duration=120.0": "duration=20.0"},
    # what compiles is made, and another fitted
    "hidden_state.md": {"horizon=100)": "horizon=100) and make_model('linear', state_lags=2)"},
    "extending/model.md": {'check_model("bilinear")\n': ""},
    "extending/kernels.md": {', "damped_lifted", "damped_block"):': ",):"},
    "adaptation.md": {
        '"sindy", degree=2': '"linear"',
        'adapt(Dataset.read("logs/"))': 'adapt(Dataset.read("logs/episode-0.csv"))',
    },
}
"""By page: a text, and what takes its place by day, so that a page takes a second."""


@pytest.fixture
def folder(tmp_path):
    """A folder with two logs, whose columns are those of a shipped map, and an example file of another kind."""
    (tmp_path / "logs").mkdir()
    rows = (f'{{"t": {0.05 * i:g}, "speed": {i % 3}}}\n' for i in range(4))
    (tmp_path / "example.jsonl").write_text("".join(rows))
    dt = 0.05
    for episode in example_dataset(episodes=2, steps=120):
        u, v, r = episode.states[:-1].T
        yaw = dt * np.cumsum(r)
        x, y = (
            dt * np.cumsum(speed) for speed in (u * np.cos(yaw) - v * np.sin(yaw), u * np.sin(yaw) + v * np.cos(yaw))
        )
        throttle, steering = np.maximum(episode.controls[:, 0], 0.0), episode.controls[:, 1]
        frame = pd.DataFrame({"t": dt * np.arange(len(u)), "throttle": throttle, "safety": 1.0, "steering": steering})
        frame = frame.assign(u=u, v=v, r=r, x=x, y=y, yaw=yaw)
        frame.to_csv(tmp_path / "logs" / f"{episode.name}.csv", index=False)
    return tmp_path


@pytest.fixture
def given():
    """Arrays and a table of a pendulum, under the names that the pages use for what a user has."""
    rng = np.random.default_rng(0)
    states, controls = rng.standard_normal((6, 2)), rng.uniform(-1.0, 1.0, 5)
    frame = pd.DataFrame(states, columns=["theta", "theta_dot"]).assign(torque=[*controls, 0.0], run=[*"aaabbb"])
    return {"states": states, "controls": controls, "frame": frame}


def of_data(folder):
    """Write the column map of the page, and two logs that it describes in place of the others."""
    (folder / "my_robot.toml").write_text(PAGES["data.md"].blocks("toml")[0].text)
    time = 0.05 * np.arange(200)
    speed, yaw_rate = 1.0 + 0.5 * np.sin(time), 0.4 * np.cos(0.7 * time)
    heading = np.concatenate([[0.0], np.cumsum(0.05 * yaw_rate)])[:-1]
    rng = np.random.default_rng(20070707)
    shutil.rmtree(folder / "logs")
    (folder / "logs").mkdir()
    for name in ("first_drive", "last_drive"):
        columns = {
            "stamp": 1e3 * time,
            "v": speed,
            "gyro_z": -np.degrees(yaw_rate),
            "voltage": np.linspace(8.2, 7.9, 200),
            "throttle": rng.uniform(0.0, 1.0, 200),
            "armed": np.ones(200),
            "servo": rng.choice(["right", "straight", "left"], 200),
            "px": 1e3 * np.cumsum(0.05 * speed * np.cos(heading)),
            "py": 1e3 * np.cumsum(0.05 * speed * np.sin(heading)),
            "yaw": np.degrees(heading),
            "wheel": speed,
        }
        pd.DataFrame(columns).to_csv(folder / "logs" / f"{name}.csv", index=False)
    inspect, store, _ = PAGES["data.md"].commands
    for line in (inspect, store):
        done(line, folder)


def of_robots(folder):
    """Write the files of the page, and run its commands on the boat."""
    boat, *_ = PAGES["robots.md"].blocks("python")
    (folder / "boat.py").write_text(boat.text)
    installed = find_spec("rotorpy") is not None
    said = [done(line, folder) for line in PAGES["robots.md"].commands if installed or "quadrotor" not in line]
    assert "A model boat" in said[1]
    assert not [line for text in said for line in text.splitlines() if line.startswith(("wrong", "FAILED"))]
    dataset = Dataset.read(folder / "data" / "boat")
    assert dataset.system.state_names == ("surge", "sway", "yaw_rate")
    assert max(episode.states[:, 0].max() for episode in dataset.episodes) > 0.5


def done(line, folder):
    """Run a command of a page in ``folder`` and return what it printed."""
    ended = run_here(*shlex.split(line)[1:], cwd=folder)
    assert ended.returncode == 0, f"{line}\n{ended.stderr}"
    return ended.stdout


BEFORE = {"data.md": of_data, "robots.md": of_robots}
"""Pages that want another folder."""


def has_run_readme(module):
    assert module.champion.against == tuple(module.models)


def has_run_data(module):
    assert module.test.names == ("last_drive",)
    assert module.data.names == ("a", "b")
    assert module.pendulum.controls[0].unit == "N m"


def has_run_kernels(module):
    for name in KERNELS:
        check_model(name)


AFTER = {"README.md": has_run_readme, "data.md": has_run_data, "extending/kernels.md": has_run_kernels}
"""What a page has made when it has run."""


@pytest.mark.parametrize("page", PAGES.values(), ids=str)
def test_a_page_is_as_it_says(page, request):
    """Its blocks are in known languages, its commands exist with their options, its links lead to files; it runs."""
    assert len(re.findall(r"^```", page.text, re.MULTILINE)) % 2 == 0
    assert set(re.findall(r"^```(\w+)", page.text, re.MULTILINE)) <= LANGUAGES
    assert [link for link in page.links if not (page.path.parent / link).exists()] == []
    groups = {registry.group for registry in KINDS.values()}
    for block in page.blocks("toml"):
        assert set(tomllib.loads(block.text).get("project", {}).get("entry-points", {})) <= groups
    for line in page.commands:
        accepted(line)
    compile(page.program(), page.name, "exec")
    if page in RUN:
        request.getfixturevalue("blank_figures")
        run(page, BUDGETS.get(page.name, {}), request)


@pytest.mark.nightly
@pytest.mark.parametrize("page", RUN, ids=str)
def test_the_python_of_a_page_runs_with_its_own_budgets_and_compiled(page, request, monkeypatch):
    monkeypatch.setenv("SYSID_EVO_ENGINE", "auto")
    run(page, {}, request)


def run(page, budget, request):
    """Run the Python of a page as one program."""
    folder, given = (request.getfixturevalue(name) for name in ("folder", "given"))
    BEFORE.get(page.name, lambda folder: None)(folder)
    with page.module(folder, given, budget) as module:
        AFTER.get(page.name, lambda module: None)(module)


commands = cache(loaded)


def accepted(line):
    """Fail unless a command exists and takes its arguments; nothing is run."""
    called, *arguments = shlex.split(line)
    assert called in {"sysid-evo", *OTHER_PROGRAMS}, line
    if called != "sysid-evo":
        return
    command = commands()
    while hasattr(command, "commands"):
        name, *arguments = arguments or [""]
        assert name in command.commands, f"no such command: {line}"
        command = command.commands[name]
    command.make_context("sysid-evo", [argument for argument in arguments if argument != "--help"])


def test_the_python_of_the_readme_needs_no_files(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    text = PAGES["README.md"].blocks("python")[-1].text
    for old, new in BUDGETS["README.md"].items():
        text = text.replace(old, new)
    exec(text, {})
    assert "standard deviations" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("kind", "page", "name"),
    [
        ("model", "extending/model.md", "bilinear"),
        ("task", "extending/task.md", "hold"),
        ("controller", "extending/controller.md", "feedback"),
        ("strategy", "extending/strategy.md", "cross_entropy"),
        ("reader", "extending/reader.md", "json_lines"),
    ],
)
def test_the_example_of_a_kind_is_what_plugin_new_writes(kind, page, name, tmp_path):
    path, *_ = write_plugin(name, tmp_path / name, kind)
    assert path.read_text() in [block.text for block in PAGES[page].blocks("python")]


def test_the_glossary_has_the_words_and_sentences_of_the_report():
    groups = tomllib.loads((ROOT / "evaluation/report/page/glossary.toml").read_text(encoding="utf-8"))
    rows = re.findall(r"^- \*\*(.+?)\*\*: (.+)$", PAGES["glossary.md"].text, re.MULTILINE)
    assert dict(rows) == {word: sentence for group in groups.values() for word, sentence in group.items()}


def test_every_kind_has_a_page():
    assert set(PLUGINS) == {"model", "task", "controller", "strategy", "reader", "robot", "adapter"}


@pytest.mark.parametrize("page", ["README.md", "CHANGELOG.md"])
def test_pages_name_the_number_of_families(page):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    found = re.search(r"(\d+) model families", (ROOT / page).read_text())
    assert int(found[1]) == len(project["entry-points"]["sysid_evo.models"])


def test_every_column_map_of_the_page_on_data_is_valid():
    car, motor = (parse_columns(block.text, "docs/data.md") for block in PAGES["data.md"].blocks("toml"))
    assert (car.name, motor.name) == ("my robot", "motor")
    assert [channel.unit for channel in motor.system({}).states] == ["rad", "rad/s"]
    assert set(shipped_names()) <= set(re.findall(r"`(\w+)`", PAGES["data.md"].text))


def test_the_column_map_of_the_page_on_data_is_read_with_the_defaults_of_its_table(folder):
    of_data(folder)
    columns = folder / "my_robot.toml"
    assert load_columns(columns).differentiated == ()
    system = Dataset.read(folder / "logs", columns=columns).system
    channels = {channel.name: channel for channel in (*system.states, *system.controls)}
    assert (channels["battery"].low, channels["battery"].neutral) == (6.0, 7.4)
    assert channels["yaw_rate"].unit == "rad/s"
    assert channels["steer"].levels == (-1.0, 0.0, 1.0)
    columns.write_text(columns.read_text().replace(", neutral = 7.4", ""))  # a state that is never 0 needs none
    assert Dataset.read(folder / "logs", columns=columns).system.states[2].neutral == 6.0


def test_the_page_on_kernels_names_nothing_that_an_installed_package_lacks():
    text = PAGES["extending/kernels.md"].text
    assert not re.search(r"python -m tests|make \w+|tests\.benchmarks|model_zoo/\w+\.py", text)
    assert set(re.findall(r"from (sysid_evo\.engine[\w.]*) import", text)) == {"sysid_evo.engine"}


@pytest.mark.nightly
def test_the_three_levels_of_the_page_on_kernels_step_alike_in_the_forms_they_promise(tmp_path, car_data, monkeypatch):
    monkeypatch.setenv("SYSID_EVO_ENGINE", "auto")
    weights, forms = np.random.default_rng(1).standard_normal((5, 78)), []
    with PAGES["extending/kernels.md"].module(tmp_path, {}, {}) as page:
        for name in KERNELS:
            assert page.difference(name) == 0.0
            model = make_model(name).fit(car_data, rng=np.random.default_rng(0))
            case = (model, page.RecurrentNetwork(), weights, PointToPoint(horizon=30), page.trial_seeds(0, 2))
            forms.append(rollout(*case).engine)
            if name != "damped":
                fast, exact = (rollout(*case, engine=engine, record=True) for engine in ("float64", "reference"))
                for a, b in zip(fast.trajectories, exact.trajectories, strict=True):
                    np.testing.assert_allclose(a.states, b.states, rtol=1e-12, atol=1e-12)
    assert forms == ["reference", "compiled float32", "compiled float32"]


def test_the_line_of_the_page_on_robots_makes_the_boat_known_wherever_it_is_installed(tmp_path):
    page = PAGES["robots.md"]
    (tmp_path / "boat.py").write_text(page.blocks("python")[0].text)
    info = tmp_path / "boat-1.0.dist-info"
    info.mkdir()
    info.joinpath("METADATA").write_text("Metadata-Version: 2.1\nName: boat\nVersion: 1.0\n")
    points = tomllib.loads(page.blocks("toml")[0].text)["project"]["entry-points"]
    lines = [f"[{group}]\n{name} = {module}\n" for group, named in points.items() for name, module in named.items()]
    info.joinpath("entry_points.txt").write_text("".join(lines))
    program = "from sysid_evo.registry import make_robot; print(make_robot('boat(waves=0.5)').physics.waves)"
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    assert subprocess.check_output([sys.executable, "-c", program], env=environment, text=True) == "0.5\n"


class Harbour:
    """A boat on the network and the tracker that sees it: answers commands, and stops when they expire."""

    def __init__(self, port, tracker):
        self.heard = []
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", port))
        self._socket.settimeout(0.005)
        self._tracker = ("127.0.0.1", tracker)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._live)
        self._thread.start()

    def _live(self):
        frame = 0
        rng = np.random.default_rng(1)
        while not self._over.is_set():
            try:
                self.heard.append(json.loads(self._socket.recv(1024)))
            except TimeoutError:
                pose = 0.001 * rng.standard_normal(3)
                message = FrameMessage(time.monotonic(), frame, "boat", True, pose)
                self._socket.sendto(format_message(message), self._tracker)
                frame += 1

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._over.set()
        self._thread.join()
        self._socket.close()


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def test_the_boat_of_the_page_on_the_network_is_driven_by_the_loop_and_left_in_neutral(tmp_path):
    page, port, tracker = PAGES["robots.md"], free_port(), free_port()
    (tmp_path / "real_boat.py").write_text(page.blocks("python")[1].text)
    mine = tmp_path / "my_boat.toml"
    text = page.blocks("toml")[1].text.replace("port = 5010\n", f"port = {port}\n")
    mine.write_text(text.replace("port = 5011\n", f"port = {tracker}\n"))
    with forgetting():
        load_plugin(tmp_path / "real_boat.py")
        robot = find_robot(str(mine))
        robot.check()
        with Harbour(port, tracker) as harbour, robot.connect() as connection:
            assert connection.gate_limits.speed == 3.0
            loop = ControlLoop(connection, robot.system, estimator=NewestPoseEstimator(robot.system))
            report = loop.run(ManoeuvrePilot(Manoeuvre("ahead", np.tile([1.0, 0.5], (8, 1)))))
            connection.close()
            time.sleep(0.05)
    assert report.reason is StopReason.PILOT, report.sentence
    driven = [word["control"] for word in harbour.heard]
    assert driven.count([1.0, 0.5]) == 8
    assert driven[-1] == [0.0, 0.0]


def test_the_robot_file_of_the_page_on_the_car_makes_a_robot(tmp_path):
    (description,) = PAGES["hardware.md"].blocks("toml")
    (tmp_path / "my_car.toml").write_text(description.text)
    robot = robots.make(robot_spec(str(tmp_path / "my_car.toml")))
    assert (robot.name, robot.port, robot.tracker.port) == ("red car", "/dev/rcb", 5005)
    assert robot.gate == GateLimits()
