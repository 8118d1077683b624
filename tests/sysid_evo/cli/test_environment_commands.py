"""An environment of Gymnasium on the command line: recorded, evolved against, driven, compared."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from evaluation.transfer import load_measured
from sysid_evo.data import Dataset
from tests.fixtures.commands import run_here

CART = 'gymnasium(id="CartPole-v1")'
TASK = 'environment(id="CartPole-v1", horizon=20)'
SHORT = ("--generations", "2", "--trials", "2", "--strategy", "mu_plus_lambda(children=5)")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a recording of a minute, and a controller evolved on the environment itself."""
    folder = tmp_path_factory.mktemp("cart")
    (folder / "mine").mkdir()
    for arguments in (
        ("record", "--robot", CART, "--minutes", "1", "--out", "data"),
        ("evolve", "--against", CART, "--task", TASK, *SHORT, "--run", "mine"),
    ):
        done = run_here(*arguments, cwd=folder)
        assert done.returncode == 0, done.stderr
    return folder


def test_a_recording_is_a_data_set_of_the_environment(folder: Path) -> None:
    dataset = Dataset.read(folder / "data")
    assert dataset.system.name == "CartPole-v1"
    assert dataset.n_steps == 3000


def test_a_controller_runs_in_the_environment_and_its_cell_is_stored(folder: Path) -> None:
    (champion,) = (folder / "mine" / "controllers").glob("gymnasium-*.json")
    done = run_here("drive", "--controller", str(champion), "--robot", CART, "--trials", "3", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert "reward" in done.stdout
    (measured,) = load_measured(folder / "mine")[0]
    assert (measured.cell.column, measured.cell.trials, measured.physical) == ("CartPole-v1 driven", 3, False)
    assert measured.cell.engine == "environment"


def test_without_a_task_the_environments_own_is_evolved_for_and_driven(folder: Path) -> None:
    command = ("evolve", "--against", CART, "--controller", "linear", *SHORT, "--run", "mine")
    planned = run_here(*command, "--dry-run", "--json", cwd=folder)
    named = run_here(*command, "--task", 'environment(id="CartPole-v1")', "--dry-run", "--json", cwd=folder)
    assert planned.returncode == 0, planned.stderr
    assert planned.stdout == named.stdout
    driven = run_here("drive", "--controller", "constant", "--robot", CART, "--trials", "2", cwd=folder)
    assert driven.returncode == 0, driven.stderr
    assert "reward" in driven.stdout
    compared = run_here("transfer", "constant", "--on", CART, "--trials", "2", cwd=folder)
    assert compared.returncode == 0, compared.stderr


def test_a_comparison_on_the_recording_has_the_environment_as_its_last_column(folder: Path) -> None:
    done = run_here(
        "compare", "--data", "data", "--robot", CART, "--models", "linear", "--task", TASK, *SHORT, "--recipe", "plain",
        "--out", "run", "--json", cwd=folder,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["transfer"]["columns"][-1] == "gymnasium"
    assert (folder / "run" / "report.html").stat().st_size > 10_000
