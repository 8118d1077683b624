"""`sysid-evo study`: planned, computed, gone on with, rendered."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from evaluation.study import Study, plan_study
from evaluation.study.planning import seconds_about
from sysid_evo.cli.progress import duration
from tests.fixtures.commands import run_here

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


def test_what_points_share_is_foreseen_once(study: Path, tmp_path: Path) -> None:
    written(tmp_path, second='"ridge=linear(ridge=0.5)"')  # no preset of which changes anything
    study.write_text(study.read_text() + 'preset = ["quick", "paper"]\n')
    plan = json.loads(run_here("study", study, "--dry-run", "--json", cwd=tmp_path).stdout)
    one, other = plan["points"][:2]
    assert one["cells"] == other["cells"]
    assert one["seconds"] > 0.0
    assert other["seconds"] == 0.0
    assert plan["seconds"] == pytest.approx(sum(point["seconds"] for point in plan["points"]), abs=0.5)
    assert 2 * plan["cells"] == sum(point["cells"] for point in plan["points"])


def test_what_a_cell_is_to_take_is_corrected_by_what_its_kind_took(study: Path) -> None:
    planned = plan_study(Study.read(study))
    fits = [cell for cell in planned.plan if cell.kind == "fit"]
    tried: dict[str, Any] = {cell.digest: None for cell in planned.plan}
    tried[fits[0].digest] = SimpleNamespace(status="done", seconds=3.0 * fits[0].seconds())
    tried[fits[1].digest] = SimpleNamespace(status="failed", seconds=1000.0)
    about = seconds_about(planned, tried)
    assert about[fits[2].digest] == pytest.approx(3.0 * fits[2].seconds())
    others = [cell for cell in planned.plan if cell.kind == "predict"]
    assert [about[cell.digest] for cell in others] == [cell.seconds() for cell in others]


@pytest.mark.parametrize("seconds, said", [(89.0, "89 s"), (90.0, "2 min"), (5399.0, "90 min"), (5400.0, "1.5 h")])
def test_a_time_is_told_in_the_unit_that_fits(seconds: float, said: str) -> None:
    assert duration(seconds) == said


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
