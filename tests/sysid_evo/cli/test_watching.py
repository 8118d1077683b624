"""`drive --controller --watch`: the page is served, waited for, and told what happens."""

from __future__ import annotations

import json
import threading
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from sysid_evo.controllers.controller import make_controller
from sysid_evo.data import Dataset
from sysid_evo.evolution import Champion
from sysid_evo.evolution.champion import save_champion
from sysid_evo.registry import make_robot
from sysid_evo.tasks.task import make_task
from tests.fixtures.commands import run_here


class Viewer(threading.Thread):
    """Opens the page as a browser does, and keeps what it is told."""

    def __init__(self, url: str) -> None:
        super().__init__()
        self.told: list[dict] = []
        self._base = urlsplit(url)
        self.start()

    def run(self) -> None:
        address = f"ws://{self._base.netloc}{self._base.path}socket"
        with connect(address, origin=f"http://{self._base.netloc}") as line:  # type: ignore[arg-type]  # it is text
            try:
                while True:
                    self.told.append(json.loads(line.recv(timeout=10.0)))
            except ConnectionClosed:
                return


@pytest.fixture
def viewers(monkeypatch: pytest.MonkeyPatch) -> list[Viewer]:
    """Who opened the page in place of a browser."""
    found: list[Viewer] = []
    monkeypatch.setattr("webbrowser.open", lambda url: found.append(Viewer(url)))
    return found


def stored(robot: str, task: str, folder: Path) -> None:
    """Store a linear controller of the robot as ``mine``."""
    system = make_robot(robot).system
    n = make_controller("linear").bind_to(make_task(task).bind(system)).n_parameters
    champion = Champion(
        "mine", np.full(n, 0.3), (robot,), "min", 0, np.zeros((1, 3)), task=task, controller="linear", system=system
    )
    save_champion(champion, folder / "mine")


@pytest.mark.parametrize(
    ("robot", "task"),
    [("pendulum", "track_reference(horizon=10)"), ("emulated_car", "point_to_point(horizon=10)")],
)
def test_who_opens_the_page_sees_every_trial(robot: str, task: str, viewers: list[Viewer], tmp_path: Path) -> None:
    stored(robot, task, tmp_path)
    done = run_here("drive", "--robot", robot, "--controller", "mine", "--trials", "2", "--open", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "Watch it at http://127.0.0.1:" in done.stdout
    (viewer,) = viewers
    viewer.join(10.0)
    setting, scenery, *readings = viewer.told
    assert setting["setting"]["robot"] == robot
    assert scenery.keys() == {"scenery"}
    steps = {(reading["trial"], reading["step"]) for reading in readings if reading.get("phase") == "controlled"}
    assert {1, 2} <= {trial for trial, _ in steps}
    assert len(steps) > 12
    assert readings[-1]["phase"] == "finished"
    assert len(readings[-1]["scores"]) == 2


def test_trials_of_a_robot_without_a_tracker_become_a_data_set(tmp_path: Path) -> None:
    stored("thermal", "set_point(horizon=12)", tmp_path)
    done = run_here(
        "drive", "--robot", "thermal", "--controller", "mine", "--trials", "3", "--out", "driven", cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    dataset = Dataset.read(tmp_path / "driven")
    assert [(episode.name, len(episode)) for episode in dataset] == [(f"trial-{i}", 12) for i in (1, 2, 3)]


def test_nobody_drives_by_hand_what_no_tracker_sees(tmp_path: Path) -> None:
    done = run_here("drive", "--robot", "thermal", "--task", "set_point", cwd=tmp_path)
    assert done.returncode == 2
    said = " ".join(done.stderr.split())
    assert "thermal has no pose to show. With --controller and --watch the page shows how" in said
