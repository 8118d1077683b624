"""The benchmarks of rollouts run, and report every model and every task."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from tests.benchmarks import task_speed
from tests.benchmarks.c_reference.__main__ import main as against_c
from tests.benchmarks.rollout.__main__ import main


@pytest.mark.nightly
def test_a_quick_run_reports_the_speed_of_every_model(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["--quick", "--json", str(tmp_path / "speeds.json")])
    rows = json.loads((tmp_path / "speeds.json").read_text())["models"]
    assert len(rows) >= 6
    assert all(speed > 0 for row in rows for speed in row["million_steps_per_second"].values())
    printed = capsys.readouterr().out
    assert all(len(line) <= 80 for line in printed.splitlines())


@pytest.mark.nightly
def test_the_c_reference_steps_with_the_numbers_of_the_engine(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if shutil.which("cc") is None and shutil.which("gcc") is None:
        pytest.skip("there is no C compiler")
    names = ["parametrised", "evolved3", "backprop27", "nearest_neighbour", "sindy", "emulated_car"]
    against_c(["--quick", "--repeats", "1", "--json", str(tmp_path / "c.json"), "--models", *names])
    rows = json.loads((tmp_path / "c.json").read_text())["models"]
    assert [row["model"] for row in rows] == names
    for row in rows:
        assert row["engine_to_c"]["median"] > 0.0
        # a waypoint more or less in 100 short trials, where rounding decides; another model would differ much more
        assert abs(row["off_percent"]["c"]) < 10.0, row
    assert all(len(line) <= 80 for line in capsys.readouterr().out.splitlines())


@pytest.mark.nightly
def test_a_quick_run_sets_the_speed_of_other_tasks_beside_waypoints(capsys: pytest.CaptureFixture[str]) -> None:
    assert task_speed.main(["--quick", "--tasks", "point_to_point, walled_track"]) == 0
    printed = capsys.readouterr().out
    assert printed.count("walled_track") == 2
    assert printed.count("1.00") >= 2
