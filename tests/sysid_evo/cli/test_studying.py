"""`sysid-evo study`: planned, computed, gone on with, rendered."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.sysid_evo.cli.calling import run_here

STUDY = """
title = "Tiny"

[experiment]
models = ["linear", {second}]
minutes = 0.5
only = "prediction"

[grid]
robot = ["emulated_car", "emulated_car(seed=1)"]
seed = {seeds}
"""


@pytest.fixture
def study(tmp_path: Path) -> Path:
    """A study file without controllers."""
    return written(tmp_path)


def written(folder: Path, second: str = '"nearest_neighbour"', seeds: str = "[0, 1]") -> Path:
    file = folder / "tiny.toml"
    file.write_text(STUDY.format(second=second, seeds=seeds))
    return file


def test_a_dry_run_shows_points_and_cells_and_makes_nothing(study: Path, tmp_path: Path) -> None:
    done = run_here("study", study, "--dry-run", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    plan = json.loads(done.stdout)
    assert [point["point"] for point in plan["points"]][:2] == ["emulated_car, seed 0", "emulated_car, seed 1"]
    assert plan["kept"] == 0
    assert plan["cells"] == sum(point["cells"] for point in plan["points"])
    assert not (tmp_path / "runs").exists()


def test_a_study_goes_on_where_it_was_and_a_finished_one_is_only_rendered(study: Path, tmp_path: Path) -> None:
    first = run_here("study", written(tmp_path, seeds="[0]"), cwd=tmp_path)
    assert first.returncode == 0, first.stderr
    more = json.loads(run_here("study", written(tmp_path), "--dry-run", "--json", cwd=tmp_path).stdout)
    assert more["kept"] == more["cells"] / 2
    half = run_here("study", study, "--render", cwd=tmp_path)
    assert "2 of 4 points are not finished" in " ".join(half.stdout.split())
    whole = run_here("study", study, cwd=tmp_path)
    assert whole.returncode == 0, whole.stderr
    assert "not finished" not in whole.stdout
    before = (tmp_path / "runs" / "tiny" / "study.json").read_text()
    again = run_here("study", tmp_path / "runs" / "tiny", cwd=tmp_path)
    assert "done" not in again.stderr.replace("are done already", "")
    assert (tmp_path / "runs" / "tiny" / "study.json").read_text() == before
    assert max(len(line) for line in again.stdout.splitlines() if "study." not in line) <= 80
    assert "nearest_neighbour" in again.stdout


def test_a_cell_that_fails_is_told_with_its_reason(tmp_path: Path) -> None:
    file = written(tmp_path, second='"bad=nearest_neighbour(state_lags=2000)"', seeds="[0, 1]")
    done = run_here("study", file, "--verbose", cwd=tmp_path)
    assert done.returncode == 3
    assert "fit bad" in done.stdout
    assert "4 of" in done.stderr


@pytest.mark.parametrize(
    "arguments, said",
    [
        (("nothing.toml",), "expected a study, found no such file"),
        (("tiny.toml", "--out", "nowhere", "--render"), "expected the folder of a study, found none"),
        (("tiny.toml", "--out", "tiny.toml"), "expected a folder, but"),
    ],
)
def test_what_is_wrong_is_a_sentence(study: Path, tmp_path: Path, arguments: tuple[str, ...], said: str) -> None:
    done = run_here("study", *arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert "".join(said.split()) in "".join(done.stderr.split())
