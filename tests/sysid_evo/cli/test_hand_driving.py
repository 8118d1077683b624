"""`sysid-evo drive` by hand: what it leaves behind, and how it ends."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from evaluation.transfer import load_measured
from hardware.connection import GateLimits
from hardware.driving.hand_driving import HandTrial
from hardware.driving.page_messages import FORWARD, LEFT
from hardware.driving.server import check_page
from hardware.emulation.tracked_robots import ModelledRobot
from hardware.recording.journal import read_journal
from hardware.run_report import LoopReport, Reason
from sysid_evo.cli.robots import Driven, add_row
from sysid_evo.data import Dataset, Trajectory
from sysid_evo.errors import MissingExtra
from sysid_evo.registry import make_robot
from sysid_evo.tasks import PointToPoint
from sysid_evo.testing import example_dataset
from tests.fixtures.commands import run_here

COMMAND = [sys.executable, "-c", "from sysid_evo.__main__ import main; main()", "drive"]
SECONDS = 3.0


def drive(
    *options: str, cwd: Path, until: Callable[[dict, float], bool], interrupt: bool = True
) -> tuple[int, str, str]:
    """Hold keys on the page from when it lets us ``until`` then or the end, and return code, output and errors."""
    process = subprocess.Popen(
        [*COMMAND, *options],
        cwd=cwd,
        env={**os.environ, "COLUMNS": "80", "TERM": "dumb"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        first = process.stdout.readline()
        found = re.search(r"http://\S+", first)
        assert found, process.communicate()
        base, began = urlsplit(found[0]), 0.0
        address = f"ws://{base.netloc}{base.path}socket"
        page = connect(address, origin=f"http://{base.netloc}", compression=None, max_queue=None)
        with suppress(ConnectionClosed), page as line:
            reading = json.loads(line.recv(timeout=20.0))
            while True:
                reading = json.loads(line.recv(timeout=20.0))
                if "scenery" in reading:
                    continue
                driving = reading["phase"] in ("ready", "driving")
                line.send(json.dumps({"keys": FORWARD | LEFT if driving else 0, "clock": time.monotonic()}))
                began = began or (time.monotonic() if reading["phase"] == "driving" else 0.0)
                if began and until(reading, time.monotonic() - began):
                    break
        if interrupt:
            process.send_signal(signal.SIGINT)
        output, errors = process.communicate(timeout=60.0)
        return process.returncode, first + output, errors
    finally:
        process.kill()
        process.communicate()


def test_what_is_driven_becomes_a_data_set_that_inspect_reads(tmp_path: Path) -> None:
    code, output, errors = drive("--out", "mine", cwd=tmp_path, until=lambda _, seconds: seconds > SECONDS)
    assert code == Reason.SIGINT.exit_code, errors
    assert "data set stored in mine" in output
    dataset = Dataset.read(tmp_path / "mine")
    assert 0.5 * SECONDS < dataset.duration < SECONDS + 2.0
    assert dataset.system.control_names == ("drive", "steer")
    assert dataset.episodes[0].states[:, 0].max() > 1.0
    assert dataset.episodes[0].states[-1, 2] > 1.0
    assert (tmp_path / "mine" / "journal" / "trial-1.rcj").is_file()
    inspected = run_here("inspect", "mine", "--json", cwd=tmp_path)
    assert json.loads(inspected.stdout)["episodes"][0]["name"] == "trial-1"


def test_a_model_is_recorded_in_the_same_way(tmp_path: Path) -> None:
    data = example_dataset().save(tmp_path / "car")
    fitted = run_here("fit", data, "--models", "linear", "--out", "runs/a", cwd=tmp_path)
    assert fitted.returncode == 0, fitted.stderr
    code, output, errors = drive(
        "--model", "linear", "--out", "felt", cwd=tmp_path, until=lambda _, seconds: seconds > SECONDS
    )
    assert code == Reason.SIGINT.exit_code, errors
    assert output.startswith("Drive linear at http://127.0.0.1:")
    episode = Dataset.read(tmp_path / "felt").episodes[0]
    assert {tuple(control) for control in episode.controls} >= {(1.0, 1.0)}
    assert np.ptp(episode.states[:, 0]) > 0.1
    assert read_journal(tmp_path / "felt/journal/trial-1.rcj").limits.speed == np.inf


@pytest.mark.nightly
def test_whole_trials_become_a_row_of_the_matrix(tmp_path: Path) -> None:
    (tmp_path / "runs/a/models").mkdir(parents=True)
    options = ("--run", "runs/a", "--name", "human", "--trials", "1")
    code, output, errors = drive(*options, cwd=tmp_path, until=lambda _, seconds: False, interrupt=False)
    assert code == 0, errors
    ((measured,), _) = load_measured(tmp_path / "runs/a")
    assert (measured.cell.champion, measured.cell.column) == ("human", "emulated_car driven")
    assert f"trial 1: {measured.cell.fitness[0]:g} waypoints" in output


def trial(number: int, fitness: float | None) -> HandTrial:
    system = make_robot("emulated_car").system
    task = PointToPoint().bind(system)
    state = task.begin(np.array([number], dtype=np.uint64))
    trajectory = Trajectory(np.zeros((3, 3)), np.zeros((2, 2)), system.dt, np.zeros((3, 3)), f"trial-{number}")
    report = LoopReport(Reason.PILOT, "", np.zeros(2), np.zeros(1))
    return HandTrial(number, f"trial-{number}", number, fitness, trajectory, state, report, GateLimits())


def test_only_trials_driven_to_their_end_count_in_the_row(tmp_path: Path) -> None:
    robot = ModelledRobot("linear", make_robot("emulated_car").dynamics)
    driven = Driven(robot, "linear", tmp_path, on_robot=False)
    add_row(driven, tmp_path, "humFc", [trial(1, None)])
    assert load_measured(tmp_path) == ((), ())
    add_row(driven, tmp_path, "humFc", [trial(1, 7.0), trial(2, None), trial(3, 9.0)])
    ((measured,), _) = load_measured(tmp_path)
    assert measured.cell.fitness.tolist() == [7.0, 9.0]
    assert (measured.cell.champion, measured.cell.column, measured.cell.unit) == ("humFc", "linear", "waypoints")
    assert (measured.on_robot, measured.physical, measured.champion.against) == (False, False, ())
    assert len(measured.cell.traces) == 2
    assert measured.cell.traces[0].waypoints.shape == (1, 2)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--robot", "emulated_car", "--model", "linear"), "--robothasnoeffectwith--model"),
        (("--model", "nothing.json"), "nothing.json"),
        (("--robot", "emulated_cat"), "Didyoumean'emulated_car'"),
        (("--out", "full"), "anewor"),
        (("--host", "192.0.2.1"), "cannotbeservedat192.0.2.1"),
        (("--controller", "x.json", "--name", "human"), "--nameisfordrivingbyhand"),
    ],
)
def test_what_cannot_be_driven_is_told_in_a_sentence(tmp_path: Path, options: tuple[str, ...], said: str) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "something").write_text("")
    done = run_here("drive", *options, cwd=tmp_path)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert said in "".join(done.stderr.split())


def test_a_page_that_cannot_be_served_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    with pytest.raises(MissingExtra, match=r"driving by hand needs the package 'uvicorn'.*sysid-evo\[drive\]"):
        check_page()
