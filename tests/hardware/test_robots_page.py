"""The page on robots does as it says: its files and commands, as they stand."""

from __future__ import annotations

import json
import os
import re
import shlex
import socket
import subprocess
import sys
import threading
import time
import tomllib
from pathlib import Path

import numpy as np
import pytest

from hardware.connection import GateLimits
from hardware.control_loop import ControlLoop
from hardware.estimator import NewestPose
from hardware.recording.manoeuvres import Manoeuvre
from hardware.recording.record import ManoeuvrePilot
from hardware.robot import find_robot
from hardware.run_report import Reason
from hardware.trackers.udp import FrameMessage
from sysid_evo.data import Dataset
from sysid_evo.registry import load_plugin, robot_spec, robots
from tests.system.rig.pose_stream import format_message

PAGE = (Path(__file__).parents[2] / "docs" / "robots.md").read_text(encoding="utf-8")

SCRIPT = """
import json, runpy, sys
from sysid_evo.cli.app import app

for words in json.loads(sys.argv[1]):
    app(words, standalone_mode=False)
runpy.run_path("checks.py")
"""
"""Runs commands one after the other, and then the page's checks."""


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGE, flags=re.DOTALL)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the page's files, and the boat's package in ``site`` as if it were installed there."""
    folder = tmp_path_factory.mktemp("page")
    boat, real_boat, checks = blocks("python")
    line, description = blocks("toml")
    site = folder / "site"
    info = site / "boat-1.0.dist-info"
    info.mkdir(parents=True)
    for place in (folder, site):
        (place / "boat.py").write_text(boat)
    (folder / "real_boat.py").write_text(real_boat)
    (folder / "checks.py").write_text(checks)
    (folder / "my_boat.toml").write_text(description)
    (points,) = tomllib.loads(line)["project"]["entry-points"].items()
    info.joinpath("METADATA").write_text("Metadata-Version: 2.1\nName: boat\nVersion: 1.0\n")
    info.joinpath("entry_points.txt").write_text(
        f"[{points[0]}]\n" + "\n".join(f"{name} = {module}" for name, module in points[1].items())
    )
    return folder


def run(folder: Path, *command: str, path: str = "") -> str:
    environment = {**os.environ, "COLUMNS": "120", "TERM": "dumb", "PYTHONPATH": path}
    done = subprocess.run(
        [sys.executable, "-c", *command], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_commands_and_checks_of_the_page_work_on_the_boat(folder: Path) -> None:
    commands = [shlex.split(line) for block in blocks("sh") for line in block.splitlines()]
    assert {command[0] for command in commands} == {"sysid-evo"}
    said = run(folder, SCRIPT, json.dumps([command[1:] for command in commands]))
    assert "A model boat" in said
    assert not [line for line in said.splitlines() if line.startswith(("wrong", "BROKEN"))]
    dataset = Dataset.read(folder / "data" / "boat")
    assert dataset.system.state_names == ("surge", "sway", "yaw_rate")
    assert max(episode.states[:, 0].max() for episode in dataset.episodes) > 0.5


def test_the_line_of_the_page_makes_the_boat_known_wherever_it_is_installed(folder: Path) -> None:
    program = "from sysid_evo.registry import make_robot; print(make_robot('boat(waves=0.5)').physics.waves)"
    assert run(folder, program, path=str(folder / "site")) == "0.5\n"


class Harbour:
    """A boat on the network and the tracker that sees it: answers commands, and stops when they expire."""

    def __init__(self, port: int, tracker: int) -> None:
        self.heard: list[dict] = []
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", port))
        self._socket.settimeout(0.005)
        self._tracker = ("127.0.0.1", tracker)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._live)
        self._thread.start()

    def _live(self) -> None:
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

    def __enter__(self) -> Harbour:
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()
        self._socket.close()


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def test_the_boat_on_the_network_is_driven_by_the_loop_and_left_in_neutral(folder: Path) -> None:
    load_plugin(folder / "real_boat.py")
    port, tracker = free_port(), free_port()
    description = (folder / "my_boat.toml").read_text()
    mine = folder / "here.toml"
    mine.write_text(description.replace("5010", str(port)).replace("5011", str(tracker)))
    try:
        robot = find_robot(str(mine))
        robot.check()
        with Harbour(port, tracker) as harbour, robot.connect() as connection:
            assert connection.gate_limits.speed == 3.0
            loop = ControlLoop(connection, robot.system, estimator=NewestPose(robot.system))
            report = loop.run(ManoeuvrePilot(Manoeuvre("ahead", np.tile([1.0, 0.5], (8, 1)))))
            connection.close()
            time.sleep(0.05)
        assert report.reason is Reason.PILOT, report.sentence
        driven = [word["control"] for word in harbour.heard]
        assert driven.count([1.0, 0.5]) == 8
        assert driven[-1] == [0.0, 0.0]
    finally:
        robots.forget("real_boat")
        sys.modules.pop("sysid_evo_plugin_real_boat", None)


def test_the_robot_file_of_the_page_on_the_car_makes_a_robot(tmp_path: Path) -> None:
    page = (Path(__file__).parents[2] / "docs" / "hardware.md").read_text(encoding="utf-8")
    (description,) = re.findall(r"```toml\n(.*?)```", page, flags=re.DOTALL)
    (tmp_path / "my_car.toml").write_text(description)
    robot = robots.make(robot_spec(str(tmp_path / "my_car.toml")))
    assert (robot.name, robot.port, robot.tracker.port) == ("red car", "/dev/rcb", 5005)
    assert robot.gate == GateLimits()
