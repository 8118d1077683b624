"""`sysid-evo drive` and `sysid-evo robots`: what is achieved on a robot, and how the command ends."""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path

import pytest

from evaluation.transfer import load_measured
from tests.fixtures.commands import run_here

UNSEEN = '''
"""A robot that no tracker sees, and one that nothing answers for."""
from dataclasses import replace

from hardware.robot import Robot
from sysid_evo.errors import LinkLost
from sysid_evo.registry import make_robot, register_robot


class Unseen(Robot):
    """The emulated car with its markers covered."""

    dynamics = None

    def __init__(self):
        self.inner = make_robot("emulated_car")
        self.name, self.system = "unseen", self.inner.system

    def connect(self, *, seed=None):
        connection = self.inner.connect(seed=seed)
        look = connection._look
        connection._look = lambda time: replace(look(time), valid=False)
        return connection


class Absent(Unseen):
    """A car that is not there."""

    def connect(self, *, seed=None):
        raise LinkLost("nothing on the port")


register_robot("unseen")(Unseen)
register_robot("absent")(Absent)
'''


@pytest.fixture(scope="module")
def evolved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run folder with a controller that knows its state 20 ms late."""
    folder = tmp_path_factory.mktemp("evolved")
    (folder / "unseen.py").write_text(UNSEEN)
    (folder / "mine").mkdir()
    done = run_here(
        "evolve", "--against", "emulated_car", "--generations", "2", "--trials", "2", "--runs", "1",
        "--estimator-delay", "20", "--run", "mine", cwd=folder,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return folder


def drive(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return run_here("drive", "--controller", controller(folder / "mine", "emulated_car"), *arguments, cwd=folder)


def controller(folder: Path, name: str) -> Path:
    """Return the file of the one controller of this name in a run folder."""
    (found,) = (folder / "controllers").glob(f"{name}-*.json")
    return found


def test_controller_drives_its_trials_and_the_cell_is_stored_in_its_run(evolved: Path) -> None:
    done = drive(evolved, "--robot", "emulated_car", "--trials", "2")
    assert done.returncode == 0, done.stderr
    assert "waypoints" in done.stdout
    assert "standard deviation" in done.stdout
    assert "commands; late by" in done.stdout
    cells, _ = load_measured(evolved / "mine")
    (measured,) = [m for m in cells if m.cell.column == "emulated_car driven"]
    assert measured.champion.name == "emulated_car"
    assert measured.champion.estimator_delay == 0.02
    assert (measured.cell.trials, measured.cell.engine, measured.on_robot, measured.physical) == (
        2,
        "robot",
        True,
        False,
    )
    assert len(measured.cell.traces) == 2
    assert not re.search("kept", done.stdout + done.stderr)


def test_a_controller_written_by_hand_drives_without_a_file(tmp_path: Path) -> None:
    asked = ("drive", "--task", "point_to_point(horizon=40)", "--trials", "2", "--controller")
    done = run_here(*asked, "pursuit(look=0.5)", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "pursuit on emulated_car driven" in done.stdout
    assert re.search(r"2 +\d+ +40", done.stdout)
    refused = run_here(*asked, "recurrent", cwd=tmp_path)
    assert (refused.returncode, "'recurrent' must be evolved before it can drive" in refused.stderr) == (2, True)


def test_what_a_controller_cannot_be_combined_with_is_refused_with_what_to_do(evolved: Path) -> None:
    file = controller(evolved / "mine", "emulated_car")
    for option, told in (
        (("--model", "linear", "--run", "my run"), f"sysid-evo transfer {file} --on linear --run 'my run'"),
        (("--name", "human"), "--name is for driving by hand"),
        (("--task", "point_to_point"), "was evolved for a task and drives that one; leave --task out"),
    ):
        refused = drive(evolved, *option)
        assert refused.returncode == 2
        assert "".join(told.split()) in "".join(refused.stderr.split())


def test_trials_that_a_fault_cuts_short_are_missing_and_the_exit_code_says_why(evolved: Path) -> None:
    done = drive(evolved, "--robot", "unseen", "--plugin", "unseen.py", "--trials", "2")
    assert done.returncode == 4, done.stderr
    assert "missing" in done.stdout
    assert "Traceback" not in done.stderr
    assert all(m.cell.column != "unseen" for m in load_measured(evolved / "mine")[0])


def test_robot_that_does_not_answer_is_a_message_and_an_exit_code(evolved: Path) -> None:
    done = drive(evolved, "--robot", "absent", "--plugin", "unseen.py")
    assert done.returncode == 4
    assert "nothing on the port" in done.stderr
    assert "Traceback" not in done.stderr


def test_report_of_a_comparison_is_made_again_with_the_achieved_column(tmp_path: Path) -> None:
    from sysid_evo.testing import example_dataset

    data = example_dataset().save(tmp_path / "car")
    compared = run_here(
        "compare", "--data", data, "--test", "episode-2", "--models", "linear,nearest_neighbour",
        "--generations", "1", "--out", "out", cwd=tmp_path,
    )  # fmt: skip
    assert compared.returncode == 0, compared.stderr
    before = json.loads((tmp_path / "out" / "report.json").read_text())
    chosen = tmp_path / "out" / before["controller_files"]["linear"]
    done = run_here("drive", "--controller", chosen, "--robot", "emulated_car", "--trials", "3", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "Report:" in done.stdout
    after = json.loads((tmp_path / "out" / "report.json").read_text())
    assert before["transfer"]["robot"] is None
    assert after["transfer"]["robot"] == "emulated_car driven"
    assert after["transfer"]["columns"] == [*before["transfer"]["columns"], "emulated_car driven"]
    (cell,) = [c for c in after["transfer"]["cells"] if c["column"] == "emulated_car driven" and c["fitness"]]
    assert (cell["champion"], cell["trials"]) == ("linear", 3)
    achieved = {c["name"]: c["achieved"] for c in after["controllers"]["controllers"]}
    assert achieved["linear"]["value"] == pytest.approx(cell["mean"])
    assert achieved["nearest_neighbour"] is None
    assert after["failures"] == before["failures"]
    assert after["prediction"] == before["prediction"]
    assert after["title"] == before["title"]
    assert "reality" in (tmp_path / "out" / "report.html").read_text()


def test_robots_are_listed_as_table_and_as_json(evolved: Path) -> None:
    listed = run_here("robots", "list", "--plugin", "unseen.py", cwd=evolved)
    assert "emulated_car" in listed.stdout
    assert "A car that is not there." in listed.stdout
    rows = json.loads(run_here("robots", "list", "--json", cwd=evolved).stdout)
    assert {"emulated_car"} <= {row["name"] for row in rows}


def test_check_says_in_sentences_what_is_right_and_in_its_exit_code_what_is_not(evolved: Path) -> None:
    right = run_here("robots", "check", "emulated_car", "--seconds", "1", "--json", cwd=evolved)
    assert right.returncode == 0, right.stderr
    findings = {finding["what"]: finding for finding in json.loads(right.stdout)}
    assert list(findings) == ["handshake", "link", "tracker", "loop", "estimate"]
    assert findings["tracker"]["figures"]["rate"] == pytest.approx(200.0)
    assert findings["estimate"]["figures"]["delay"] == pytest.approx(0.02, abs=0.002)
    unseen = run_here("robots", "check", "unseen", "--plugin", "unseen.py", cwd=evolved)
    assert unseen.returncode == 4
    assert "wrong" in unseen.stdout
    absent = run_here("robots", "check", "absent", "--plugin", "unseen.py", cwd=evolved)
    assert absent.returncode == 4
    assert "nothing on the port" in absent.stdout
