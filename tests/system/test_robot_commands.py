"""Commands of robots: drive a controller, record, robots, and environments of Gymnasium."""

import json
import re

import numpy as np
import pytest

from evaluation.transfer.matrix import load_measured
from hardware.run_report import StopReason
from hardware.self_test import SelfTestFinding
from sysid_evo.data import Dataset
from sysid_evo.registry import make_robot
from sysid_evo.registry.registry import robots
from tests.fixtures.commands import SMALL, Caller, run_here
from tests.fixtures.robots import store_champion
from tests.fixtures.session import copy_run

pytestmark = pytest.mark.usefixtures("blank_figures")
UNSEEN = '''
"""A robot that no tracker sees, one that nothing answers for, and a simulator that falls asleep."""
import time
from dataclasses import replace

import numpy as np

from hardware.simulators.simulator import ExternalSimulator, SimulatorSession
from hardware.simulators.simulator_robot import SimulatorRobot
from hardware.robot import Robot
from sysid_evo import Channel, System
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


class Asleep(ExternalSimulator, SimulatorSession):
    name, system, settable, steps = "asleep", System(["x"], [Channel("u", low=-1.0, high=1.0)], dt=0.05), False, 0

    def open(self):
        return self

    def reset(self, seed, at=None):
        return np.zeros(1)

    def step(self, control):
        self.steps += 1
        if self.steps > 150:
            time.sleep(1e6)
        return np.zeros(1), 0.0, self.steps % 50 == 0, False

    def close(self):
        pass


class Sleeper(SimulatorRobot):
    """Does not answer."""

    answers_within = 0.5


register_robot("unseen")(Unseen)
register_robot("absent")(Absent)
register_robot("asleep")(lambda: Sleeper(Asleep()))
'''


@pytest.fixture(scope="module")
def evolved(tmp_path_factory):
    """A run folder with a controller that knows its state 20 ms late."""
    folder = tmp_path_factory.mktemp("evolved")
    (folder / "unseen.py").write_text(UNSEEN)
    (folder / "mine").mkdir()
    done = run_here(
        "evolve", "--against", "emulated_car", *SMALL, "--estimator-delay", "20ms", "--run", "mine", cwd=folder
    )
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture
def there(evolved, capsys):
    return Caller(evolved, capsys)


def champion_in(folder, name="emulated_car"):
    """Return the file of the one controller of this name in a run folder."""
    (found,) = (folder / "controllers").glob(f"{name}-*.json")
    return found


def test_controller_drives_its_trials_and_the_cell_is_stored_in_its_run(there):
    run = there.folder / "mine"
    done = there.works("drive", "--controller", champion_in(run), "--robot", "emulated_car", "--trials", "2")
    assert "waypoints" in done.stdout
    assert "standard deviation" in done.stdout
    assert "commands; late by" in done.stdout
    (measured,) = [m for m in load_measured(run)[0] if m.cell.column == "emulated_car driven"]
    assert measured.champion.name == "emulated_car"
    assert measured.champion.estimator_delay == 0.02
    assert (measured.cell.trials, measured.cell.engine) == (2, "robot")
    assert (measured.on_robot, measured.physical) == (True, False)
    assert len(measured.cell.traces) == 2
    assert not re.search("kept", done.stdout + done.stderr)


def test_a_controller_written_by_hand_drives_without_a_file(call):
    done = call.works(
        "drive", "--task", "point_to_point(horizon=40)", "--trials", "2", "--controller", "pursuit(look=0.5)"
    )
    assert "pursuit on emulated_car driven" in done.stdout
    assert re.search(r"2 +\d+ +40", done.stdout)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--model", "linear", "--run", "my run"), "sysid-evo transfer FILE --on linear --run 'my run'"),
        (("--name", "human"), "--name is for driving by hand"),
        (("--task", "point_to_point"), "was evolved for a task, which is used; leave --task out"),
    ],
)
def test_what_a_controller_cannot_be_combined_with_is_refused_with_what_to_do(options, told, there):
    file = champion_in(there.folder / "mine")
    assert there.refused("drive", "--controller", file, *options).says(told.replace("FILE", str(file)))


def test_an_exported_file_and_a_run_folder_are_refused_with_what_to_name(there):
    assert there.refused("drive", "--controller", "car.py").says("car.py is an exported file, which runs without")
    chosen = champion_in(there.folder / "mine").with_suffix("").relative_to(there.folder)
    named = str(chosen).rpartition("-")[0]
    assert there.refused("drive", "--controller", "./mine").says(f"There are {named}")


def test_trials_that_a_fault_cuts_short_are_missing_and_the_exit_code_says_why(there):
    command = ("drive", "--controller", champion_in(there.folder / "mine"), "--plugin", "unseen.py", "--robot")
    done = there(*command, "unseen", "--trials", "2")
    assert done.code == 4, done.stderr
    assert re.search(r"^ *1 to 2 +missing ", done.stdout, re.MULTILINE)
    assert "Traceback" not in done.stderr
    assert all(m.cell.column != "unseen" for m in load_measured(there.folder / "mine")[0])
    done = there(*command, "absent")
    assert done.code == 4
    assert "nothing on the port" in done.stderr
    assert "Traceback" not in done.stderr


def test_report_of_a_comparison_is_made_again_with_the_achieved_column(call, failed_run):
    copy_run(failed_run, call.folder / "out")
    document = call.folder / "out" / "report.json"
    before = json.loads(document.read_text())
    files = {one["name"]: one["file"] for one in before["controllers"]["controllers"]}
    chosen = call.folder / "out" / files["linear"]
    driven = call.works("drive", "--controller", chosen, "--robot", "emulated_car", "--trials", "3")
    assert "Report: out/report.html" in driven.stdout.splitlines()
    after = json.loads(document.read_text())
    assert before["transfer"]["robot"] is None
    assert after["transfer"]["robot"] == "emulated_car driven"
    assert after["transfer"]["columns"] == [*before["transfer"]["columns"], "emulated_car driven"]
    (cell,) = [c for c in after["transfer"]["cells"] if c["column"] == "emulated_car driven" and c["fitness"]]
    assert (cell["controller"], cell["trials"]) == ("linear", 3)
    achieved = {c["name"]: c["achieved"] for c in after["controllers"]["controllers"]}
    assert achieved["linear"]["value"] == pytest.approx(cell["mean"])
    assert achieved["near"] is None
    assert after["run"]["failures"] == before["run"]["failures"]
    for part in ("prediction", "title"):
        assert after[part] == before[part]
    assert "emulated_car driven" in (call.folder / "out" / "report.html").read_text()


def test_robots_are_listed_as_table_and_as_json(there):
    listed = there("robots", "list", "--plugin", "unseen.py")
    assert "emulated_car" in listed.stdout
    assert "A car that is not there." in listed.stdout
    assert "emulated_car" in {row["name"] for row in there.told("robots", "list", "--json")}


def test_check_says_in_sentences_what_is_right_and_in_its_exit_code_what_is_not(there):
    right = there.works("robots", "check", "emulated_car", "--seconds", "1", "--json")
    findings = {finding["check"]: finding for finding in json.loads(right.stdout)}
    assert list(findings) == ["handshake", "link", "tracker", "loop", "estimate"]
    assert findings["tracker"]["figures"]["rate"] == pytest.approx(200.0)
    assert findings["estimate"]["figures"]["delay"] == pytest.approx(0.02, abs=0.002)
    for robot, said in (("unseen", "wrong"), ("absent", "nothing on the port")):
        ended = there("robots", "check", robot, "--plugin", "unseen.py")
        assert ended.code == 4
        assert said in ended.stdout
        lines = ended.stdout.splitlines()
        assert all(line.startswith(("ok    ", "wrong ", "      ")) and len(line) <= 80 for line in lines)


def test_a_check_that_is_stopped_prints_what_it_found_and_ends_with_the_code_of_the_reason(call, register):
    class Stopped(type(make_robot("emulated_car"))):
        def self_test(self, *, seconds, stop):
            stop.request(StopReason.SIGTERM)
            return [SelfTestFinding("link", True, "it was fine until then")]

    def stopped():
        robot = make_robot("emulated_car")
        robot.__class__ = Stopped
        return robot

    register(robots, "stopped", stopped)
    ended = call("robots", "check", "stopped")
    assert ended.code == 143
    assert "it was fine until then" in ended.stdout
    assert ended.says("terminated")


def test_a_robot_that_does_not_answer_any_more_is_a_sentence_and_what_was_recorded_is_kept(there, tmp_path):
    given = ("--plugin", "unseen.py")
    for command in (
        ("robots", "check", "asleep"),
        ("record", "--robot", "asleep", "--minutes", "1", "--out", tmp_path / "kept"),
    ):
        ended = there(*command, *given)
        assert (ended.code, ended.says("asleep: no answer for 0.5 s")) == (4, True), ended.stderr
    assert len(Dataset.load(tmp_path / "kept")) == 3


def test_recording_leaves_journals_raw_logs_and_a_data_set_and_is_not_overwritten(call):
    arguments = ("record", "--minutes", "0.4", "--seed", "3", "--out", "car")
    done = call.works(*arguments)
    assert "data set stored in" in done.stdout
    assert "without delay" in done.stderr
    folder = call.folder / "car"
    stored, journals, logs = Dataset.load(folder), Dataset.read(folder / "journal"), Dataset.read(folder / "raw")
    assert len(stored) == len(list((folder / "journal").glob("*.rcj"))) == len(list((folder / "raw").glob("*.csv")))
    assert set(journals.names) == set(logs.names) == set(stored.names)
    for one in stored:
        (journal,), (log,) = ([other for other in some if other.name == one.name] for some in (journals, logs))
        assert np.array_equal(journal.states, one.states)
        assert np.array_equal(journal.controls, one.controls)
        np.testing.assert_allclose(log.states, one.states, atol=1e-5)  # as text
        assert np.array_equal(log.controls, one.controls)
    second = call.refused(*arguments)
    assert second.says("expected a new or an empty folder")
    assert "Traceback" not in second.stderr


def test_a_robot_without_a_pose_is_recorded_by_what_its_sensors_say(call):
    call.works("record", "--robot", "pendulum", "--minutes", "0.3", "--out", "swing")
    assert Dataset.load(call.folder / "swing").system.state_names == ("angle", "angular_speed")
    log = next((call.folder / "swing" / "raw").glob("*.csv"))
    assert log.read_text().splitlines()[0] == "t,torque,angle,angular_speed"


def test_trials_of_a_robot_without_a_tracker_become_a_data_set(call):
    store_champion("thermal", "set_point(horizon=12)", call.folder)
    call.works("drive", "--robot", "thermal", "--controller", "mine", "--trials", "3", "--out", "driven")
    dataset = Dataset.read(call.folder / "driven")
    assert [(episode.name, len(episode)) for episode in dataset] == [(f"trial-{i}", 12) for i in (1, 2, 3)]


CART = 'gymnasium(id="CartPole-v1")'
CART_TASK = 'environment(id="CartPole-v1", horizon=20)'
SHORT = ("--generations", "2", "--trials", "2", "--strategy", "mu_plus_lambda(children=5)")


@pytest.fixture(scope="module")
def cart(tmp_path_factory):
    """A folder with a recording of 18 s, and a controller evolved on the environment itself."""
    folder = tmp_path_factory.mktemp("cart")
    (folder / "mine").mkdir()
    for command in (
        ("record", "--robot", CART, "--minutes", "0.3", "--out", "data"),
        ("evolve", "--against", CART, "--task", CART_TASK, *SHORT, "--run", "mine"),
    ):
        done = run_here(*command, cwd=folder)
        assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture
def call_cart(cart, capsys):
    return Caller(cart, capsys)


def test_a_recording_is_a_data_set_of_the_environment(cart):
    dataset = Dataset.read(cart / "data")
    assert dataset.system.name == "CartPole-v1"
    assert 850 < dataset.n_steps <= 900  # a trial of a step or two is no episode


def test_a_controller_runs_in_the_environment_and_its_cell_is_stored(call_cart, cart):
    done = call_cart.works(
        "drive", "--controller", champion_in(cart / "mine", "gymnasium"), "--robot", CART, "--trials", "3"
    )
    assert "reward" in done.stdout
    (measured,) = load_measured(cart / "mine")[0]
    assert (measured.cell.column, measured.cell.trials, measured.physical) == ("CartPole-v1 driven", 3, False)
    assert measured.cell.engine == "environment"


def test_without_a_task_the_environments_own_is_evolved_for_and_driven(call_cart):
    command = ("evolve", "--against", CART, "--controller", "linear", *SHORT, "--run", "mine", "--dry-run", "--json")
    planned, named = call_cart(*command), call_cart(*command, "--task", 'environment(id="CartPole-v1")')
    assert planned.code == 0, planned.stderr
    assert planned.stdout == named.stdout
    assert "reward" in call_cart.works("drive", "--controller", "constant", "--robot", CART, "--trials", "2").stdout
    call_cart.works("transfer", "constant", "--on", CART, "--trials", "2")


def test_a_comparison_on_the_recording_has_the_environment_as_its_last_column(call_cart, cart):
    done = call_cart.works(
        "compare", "--data", "data", "--robot", CART, "--models", "linear", "--task", CART_TASK, *SHORT,
        "--procedure", "plain", "--out", "run", "--json",
    )  # fmt: skip
    assert json.loads(done.stdout)["transfer"]["columns"][-1] == "gymnasium"
    assert (cart / "run" / "report.html").stat().st_size > 10_000
