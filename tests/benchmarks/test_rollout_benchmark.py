"""The benchmarks of rollouts run, and report every model and every task."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.benchmarks import regressors, task_speed
from tests.benchmarks.rollout import main


@pytest.mark.nightly
def test_a_quick_run_reports_the_speed_of_every_model(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["--quick", "--json", str(tmp_path / "speeds.json")])
    rows = json.loads((tmp_path / "speeds.json").read_text())["models"]
    assert len(rows) >= 6
    assert all(speed > 0 for row in rows for speed in row["million_steps_per_second"].values())
    printed = capsys.readouterr().out
    assert all(len(line) <= 80 for line in printed.splitlines())


@pytest.mark.nightly
def test_a_quick_run_sets_the_speed_of_other_tasks_beside_waypoints(capsys: pytest.CaptureFixture[str]) -> None:
    assert task_speed.main(["--quick", "--tasks", "point_to_point, walled_track"]) == 0
    printed = capsys.readouterr().out
    assert printed.count("walled_track") == 2
    assert printed.count("1.00") >= 2


@pytest.mark.nightly
def test_a_compiled_regressor_is_a_hundred_times_as_fast_as_predict_step_by_step(
    capsys: pytest.CaptureFixture[str],
) -> None:
    regressors.main(["--quick", "--models", "forest=regressor(estimator=RandomForestRegressor, max_depth=10)"])
    (row,) = (line.split() for line in capsys.readouterr().out.splitlines() if "forest" in line)
    assert float(row[-1]) > 100
