"""Commands of controllers in models: evolve, exploit, transfer."""

import json
import shutil

import pytest

from sysid_evo.evolution.champion import load_champion
from tests.fixtures.commands import SMALL, Caller, run_here

pytestmark = pytest.mark.usefixtures("blank_figures")
TASK = "point_to_point(horizon=40)"
STRATEGY = ("--trials", "2", "--strategy", "mu_plus_lambda(parents=2, children=2)")
SEARCH = ("--generations", "2", *STRATEGY, "--task", TASK, "--controller", "recurrent(hidden=2)")


def test_a_controller_evolves_against_an_ensemble_and_inspect_says_where_it_goes(call, run_copy, stored_data):
    evolved = call.works(
        "evolve", "--run", "out", "--against", "linear,near", "--aggregate", "min", *SMALL,
        "--noise", "domain_randomisation(sensor=0.1, process=0.1)",
    )  # fmt: skip
    assert "linear:" in evolved.stdout
    assert " fresh trials, whose standard deviation is " in evolved.stdout
    assert "Forecast for the robot, by 2 models: " in evolved.stdout
    controller = call.folder / evolved.stdout.split("stored as ")[1].strip()
    assert controller.parent == run_copy / "controllers"
    assert controller.with_suffix(".safetensors").is_file()
    assert "What to record next?" in evolved.stdout
    told = [line for line in evolved.stdout.splitlines() if not line.startswith("stored as")]
    assert max(map(len, told)) <= 80
    command = evolved.stderr.split("take it away as one file with: sysid-evo ")[1].split()
    call.works(*command, "--name", "mine")
    assert (call.folder / "mine.py").is_file()
    assert f"sysid-evo drive --robot ROBOT --controller {controller.relative_to(call.folder)}" in evolved.stderr
    inspected = call.works("inspect", stored_data, "--controller", controller)
    assert "What to record next?" in inspected.stdout
    assert "Controllers spend " in " ".join(inspected.stdout.split())


def test_a_controller_evolves_on_the_emulated_car_without_any_model(call):
    assert "emulated_car:4:" in call.works("evolve", "--against", "emulated_car:4", *SMALL).stdout
    assert len(list(call.folder.glob("runs/*/controllers/emulated_car-4-*.safetensors"))) == 1


def test_the_yardstick_of_a_comparison_is_a_row_of_its_matrix(call, stored_data):
    robot = ("--robot", "emulated_car", "--reference", "yes", *SMALL, "--procedure", "plain")
    done = call.works("compare", "--data", stored_data, "--models", "linear", *robot, "--out", "out")
    assert "evolve emulated_car" in done.stderr
    report = json.loads((call.folder / "out" / "report.json").read_text())
    assert [one["name"] for one in report["evolution"]["controllers"]] == ["linear", "emulated_car"]


@pytest.fixture(scope="module")
def runs(tmp_path_factory, stored_data):
    """A folder with three models and two controllers in ``one``, another of the same name in ``two``."""
    folder = tmp_path_factory.mktemp("evolved")
    evolve = ("evolve", *SEARCH, "--procedure", "plain", "--against")
    for command in (
        ("fit", stored_data, "--models", "linear,nearest_neighbour,k_neighbours", "--out", "one"),
        (*evolve, "linear", "--run", "one", "--repeats", "2"),
        (*evolve, "nearest_neighbour", "--run", "one", "--repeats", "1"),
        ("fit", stored_data, "--models", "linear", "--out", "two"),
        (*evolve, "linear", "--run", "two", "--repeats", "1"),
    ):
        done = run_here(*command, cwd=folder)
        assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture
def there(runs, capsys):
    return Caller(runs, capsys)


def test_what_one_model_alone_believes_is_searched_told_and_kept(call, run_copy):
    told = call.told("exploit", "linear", "--run", "out", *SEARCH, "--json")
    assert (told["model"], told["unit"]) == ("linear", "waypoints")
    assert set(told["fitness"]) == {"linear", "near"}
    assert told["exploitability"]["model"] == "linear"
    assert told["card"][0].startswith("linear: ")
    champion = load_champion(call.folder / told["file"])
    assert (champion.against, len(champion.history)) == (("linear",), 2)
    said = call("exploit", "linear", "--run", "out", *SEARCH)
    assert "is done already" in said.stderr or "are done already" in said.stderr
    assert said.stdout.startswith("exploit of linear: ")
    assert "stored as out/controllers/exploit-of-linear-" in said.stdout


@pytest.mark.parametrize(
    ("model", "run", "said"),
    [
        ("linear", "two", "expected models of other families than linear in the run, found none: fit some more"),
        ("sindy", "one", "'sindy' is not among the models of one: linear, nearest_neighbour, k_neighbours"),
    ],
)
def test_a_search_for_exploits_that_lacks_a_model_is_refused(model, run, said, there):
    assert there.refused("exploit", model, "--run", run, *SEARCH).says(said)


def stored(folder):
    """Return the file of the controller that was evolved on the linear model in ``one``."""
    (file,) = (folder / "one" / "controllers").glob("linear-*.json")
    return file.relative_to(folder)


def transferred(there, *arguments):
    return there.told("transfer", *arguments, "--json")


def test_every_controller_of_a_run_is_run_on_every_model_with_intervals(there):
    told = transferred(there, "one", "--on", "one", "--trials", "5")
    assert told["transfer"]["rows"] == ["linear", "nearest_neighbour"]
    assert set(told["transfer"]["columns"]) == {"linear", "nearest_neighbour", "k_neighbours"}
    assert (told["transfer"]["trials"], told["transfer"]["robot"]) == (5, None)
    assert all(len(cell["interval"]) == 2 for cell in told["transfer"]["cells"])
    first, second = told["controllers"]["controllers"]
    assert first["against"] == ["linear"]
    assert set(first["other_family_models"]) == {"nearest_neighbour", "k_neighbours"}
    assert first["claimed"]["value"] is not None
    assert [len(one["seed_fitness"]) for one in (first, second)] == [2, 1]


def test_a_file_and_one_written_by_hand_stand_beside_each_other_on_a_robot(there):
    ended = there.works(
        "transfer", stored(there.folder), "pursuit", "--on", "linear,emulated_car", "--run", "one", "--trials", "3"
    )
    assert "Transfer matrix: waypoints" in ended.stdout
    assert "All figures of each controller" in ended.stdout
    assert "emulated_car" in ended.stdout
    assert max(map(len, ended.stdout.splitlines())) <= 80
    assert any(line.split()[:3] == ["pursuit", "(baseline)", "–"] for line in ended.stdout.splitlines())


def test_the_same_model_is_known_by_its_content_and_names_of_two_runs_are_told_apart(there):
    told = transferred(there, "one", "two", "--on", "linear,nearest_neighbour", "--run", "one", "--trials", "2")
    rows = {"one/linear": "linear", "nearest_neighbour": "nearest_neighbour", "two/linear": "linear"}
    assert told["transfer"]["rows"] == list(rows)
    # both runs fitted the same family with the same data and seed: one and the same model
    against = {one["name"]: one["against"] for one in told["controllers"]["controllers"]}
    assert against == {row: [model] for row, model in rows.items()}


def test_a_model_that_is_not_among_the_systems_is_no_claim_but_still_of_its_family(there):
    told = transferred(there, "one", "--on", "nearest_neighbour,k_neighbours", "--run", "one", "--trials", "2")
    first = told["controllers"]["controllers"][0]
    assert first["against"] == ["one/linear"]
    assert first["claimed"] is None


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("FILE", "--on", "linear,pendulum"), "linear cannot be run on pendulum: controller 'linear' was evolved for"),
        (("FILE", "--on", "linear", "--task", "walled_track"), "linear cannot do walled_track: it needs"),
        (("one", "--on", "sindy"), "'sindy' is not among the models of one"),
        (("nobody", "--on", "linear"), "nobody"),
    ],
)
def test_what_does_not_fit_is_refused_before_anything_runs(arguments, said, there):
    arguments = (stored(there.folder) if word == "FILE" else word for word in arguments)
    ended = there.refused("transfer", *arguments, "--run", "one")
    assert ended.says(said)
    assert ended.stdout == ""


def test_controllers_of_different_tasks_are_not_compared(there, tmp_path):
    file, other = stored(there.folder), tmp_path / "other.json"
    other.write_text((there.folder / file).read_text().replace("horizon=40", "horizon=41"))
    shutil.copy((there.folder / file).with_suffix(".safetensors"), other.with_suffix(".safetensors"))
    command = (file, other, "--on", "linear", "--run", "one")
    ended = there.refused("transfer", *command)
    assert ended.says("their scores cannot be compared. Name one task for all with --task")
    rows = transferred(there, *command, "--task", TASK, "--trials", "2")["transfer"]["rows"]
    assert rows == ["one/linear", "linear"] or rows == ["linear#1", "linear#2"]
