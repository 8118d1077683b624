"""The command that compares CMA-ES with the library."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.benchmarks import cma


def test_runs_that_were_made_are_not_made_again(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(cma, "CASES", (cma.Case(cma.sphere, 3, 6, 1.0, 1.0, 200, 1e-3),))
    file = tmp_path / "runs.json"
    assert cma.main(["functions", "--seeds", "2", "--json", str(file)]) == 0
    made = json.loads(file.read_text())
    assert [(run["who"], run["seed"]) for run in made] == [("ours", 0), ("cma", 0), ("ours", 1), ("cma", 1)]
    assert all(run["best"] <= 1e-3 for run in made)
    cma.main(["functions", "--seeds", "2", "--json", str(file)])
    assert json.loads(file.read_text()) == made
