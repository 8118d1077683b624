"""`sysid-evo transfer`: any stored controllers on any systems, and what does not fit is said before anything runs."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from tests.fixtures.commands import Caller, run_here

BUDGET = ("--generations", "2", "--trials", "2", "--strategy", "mu_plus_lambda(parents=2, children=2)")
TASK = "point_to_point(horizon=40)"
SEARCH = (*BUDGET, "--task", TASK, "--controller", "recurrent(hidden=2)", "--recipe", "plain", "--jobs", "1")


@pytest.fixture(scope="module")
def evolved(tmp_path_factory: pytest.TempPathFactory, logs: Path) -> Path:
    """A folder with three models and two controllers in ``one``, another of the same name in ``two``."""
    folder = tmp_path_factory.mktemp("evolved")
    for out, models, against in (
        ("one", "linear,nearest_neighbour,k_neighbours", ("linear", "nearest_neighbour")),
        ("two", "linear", ("linear",)),
    ):
        done = [run_here("fit", logs, "--models", models, "--out", out, "--jobs", "1", cwd=folder)]
        for runs, model in zip(("2", "1"), against, strict=False):
            done.append(run_here("evolve", "--against", model, "--run", out, "--runs", runs, *SEARCH, cwd=folder))
        assert not any(one.returncode for one in done), done[-1].stderr
    return folder


@pytest.fixture
def there(evolved: Path, capsys: pytest.CaptureFixture[str]) -> Caller:
    return Caller(evolved, capsys)


def stored(folder: Path, run: str, name: str) -> str:
    (file,) = (folder / run / "controllers").glob(f"{name}-*.json")
    return str(file.relative_to(folder))


def test_every_controller_of_a_run_is_run_on_every_model_with_intervals(there: Caller) -> None:
    ended = there("transfer", "one", "--on", "one", "--trials", "5", "--json")
    assert ended.code == 0, ended.stderr
    told = json.loads(ended.stdout)
    assert told["transfer"]["rows"] == ["linear", "nearest_neighbour"]
    assert set(told["transfer"]["columns"]) == {"linear", "nearest_neighbour", "k_neighbours"}
    assert (told["transfer"]["trials"], told["transfer"]["robot"]) == (5, None)
    assert all(len(cell["interval"]) == 2 for cell in told["transfer"]["cells"])
    first, second = told["controllers"]["controllers"]
    assert first["against"] == ["linear"]
    assert set(first["judges"]) == {"nearest_neighbour", "k_neighbours"}
    assert first["standing"]["claimed"]["value"] is not None
    assert [len(one["seed_fitness"]) for one in (first, second)] == [2, 1]


def test_a_file_and_one_written_by_hand_stand_beside_each_other_on_a_robot(there: Caller, evolved: Path) -> None:
    ended = there(
        "transfer", stored(evolved, "one", "linear"), "pursuit", "--on", "linear,emulated_car", "--run", "one",
        "--trials", "3",
    )  # fmt: skip
    assert ended.code == 0, ended.stderr
    assert "Transfer matrix: waypoints" in ended.stdout
    assert "Claimed, achieved, worst case, regret" in ended.stdout
    assert "emulated_car" in ended.stdout
    assert max(map(len, ended.stdout.splitlines())) <= 80
    lines = [line.split() for line in ended.stdout.splitlines()]
    assert any(line[:2] == ["pursuit", "–"] for line in lines)


def test_the_same_model_is_known_by_its_content_and_names_of_two_runs_are_told_apart(there: Caller) -> None:
    ended = there(
        "transfer", "one", "two", "--on", "linear,nearest_neighbour", "--run", "one", "--trials", "2", "--json"
    )
    told = json.loads(ended.stdout)
    assert told["transfer"]["rows"] == ["one/linear", "nearest_neighbour", "two/linear"]
    against = {one["name"]: one["against"] for one in told["controllers"]["controllers"]}
    # both runs fitted the same family with the same data and seed: one and the same model
    assert against == {"one/linear": ["linear"], "nearest_neighbour": ["nearest_neighbour"], "two/linear": ["linear"]}


def test_a_model_that_is_not_among_the_systems_is_no_claim_but_still_of_its_family(there: Caller) -> None:
    ended = there(
        "transfer", "one", "--on", "nearest_neighbour,k_neighbours", "--run", "one", "--trials", "2", "--json"
    )
    told = json.loads(ended.stdout)["controllers"]["controllers"][0]
    assert told["against"] == ["one/linear"]
    assert told["standing"]["claimed"] is None


def test_a_controller_that_does_not_fit_is_refused_before_anything_runs(there: Caller, evolved: Path) -> None:
    file = stored(evolved, "one", "linear")
    ended = there("transfer", file, "--on", "linear,pendulum", "--run", "one")
    assert ended.code == 2
    assert ended.says("linear cannot be run on pendulum: controller 'linear' was evolved for another system")
    assert ended.stdout == ""
    ended = there("transfer", file, "--on", "linear", "--run", "one", "--task", "walled_track")
    assert ended.code == 2
    assert ended.says("linear cannot do walled_track: there it needs")


def test_controllers_of_different_tasks_are_not_compared(there: Caller, evolved: Path, tmp_path: Path) -> None:
    file = stored(evolved, "one", "linear")
    other = tmp_path / "other.json"
    text = (evolved / file).read_text()
    other.write_text(text.replace("horizon=40", "horizon=41"))
    shutil.copy((evolved / file).with_suffix(".safetensors"), other.with_suffix(".safetensors"))
    ended = there("transfer", file, str(other), "--on", "linear", "--run", "one")
    assert ended.code == 2
    assert ended.says("what they score cannot be compared. Name one task for all with --task")
    ended = there(
        "transfer", file, str(other), "--on", "linear", "--run", "one", "--task", TASK, "--trials", "2", "--json"
    )
    assert ended.code == 0
    rows = json.loads(ended.stdout)["transfer"]["rows"]
    assert rows == ["one/linear", "linear"] or rows == ["linear#1", "linear#2"]


def test_what_there_is_not_is_said(there: Caller) -> None:
    ended = there("transfer", "one", "--on", "sindy", "--run", "one")
    assert ended.code == 2
    assert ended.says("'sindy' is not among the models of one")
    ended = there("transfer", "nobody", "--on", "linear", "--run", "one")
    assert ended.code == 2
    assert ended.says("nobody")
