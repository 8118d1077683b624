"""Comparison of two studies: fitness is paired by robot and seed."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from tests.benchmarks.two_versions import compared

ROBOTS, SEEDS = ("first", "second", "third"), (0, 1)


def test_differences_are_paired_by_robot_and_seed(tmp_path: Path) -> None:
    points = [(robot, seed) for robot in ROBOTS for seed in SEEDS]
    rows = [("linear", robot, seed, 10.0 * ROBOTS.index(robot) + seed) for robot, seed in points]
    columns = ["controller", "axis_robot", "axis_seed", "achieved"]
    for name, gain in (("old", 0.0), ("new", 0.5)):
        (tmp_path / name).mkdir()
        shuffled = pd.DataFrame(rows, columns=columns).sample(frac=1.0, random_state=int(2 * gain))
        shuffled["achieved"] += gain
        shuffled.to_parquet(tmp_path / name / "controllers.parquet")
    table = compared(tmp_path / "old", tmp_path / "new")
    cells = [list(column.cells) for column in table.columns]
    assert [column[0] for column in cells] == ["linear", "10.50", "11.00", "+0.50", "+0.50 to +0.50", "6 of 6"]
