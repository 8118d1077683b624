"""The benchmark of growth: its slopes, and that it runs."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from sysid_evo.registry import models
from tests.benchmarks.growth.__main__ import main
from tests.benchmarks.growth.measuring import doubled, slope


@pytest.mark.parametrize("power", [0.0, 1.0, 2.0])
def test_the_slope_is_the_power_in_the_upper_part_of_the_range(power: float) -> None:
    sizes = np.array(doubled(10, 10_000))
    assert slope(sizes, 50.0 * (sizes / 1e4) ** power) == pytest.approx(power, abs=1e-9)


def test_a_fixed_cost_of_small_sizes_does_not_hide_that_large_ones_grow_with_their_square() -> None:
    sizes = np.array(doubled(10, 10_000, 4))
    assert slope(sizes, 1.0 + (sizes / 100.0) ** 2) > 1.8


@pytest.mark.nightly
def test_a_quick_run_measures_every_family(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["--quick", "--parts", "fits,commands", "--out", str(tmp_path)])
    rows = json.loads((tmp_path / "growth.json").read_text())
    names = {row["name"] for row in rows}
    assert {f"fit {name}" for name in models.names()} <= names
    assert {"sysid-evo import", "sysid-evo inspect"} <= names
    assert all(value > 0.0 for row in rows for value in (*row["seconds"], *row["megabytes"]))
    assert "grows with" in capsys.readouterr().out
