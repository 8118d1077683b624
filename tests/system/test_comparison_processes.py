"""Comparisons in real processes: the report is the same for any number of jobs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from evaluation.cells.data import GivenData
from evaluation.experiment import Experiment, meaningful
from evaluation.planning import comparison_again, plan_comparison
from evaluation.report import to_json
from evaluation.running import compare
from sysid_evo.plan import Observer, Record, StoredCell
from sysid_evo.registry import make_robot
from sysid_evo.testing import example_dataset

ROOT = Path(__file__).parents[2]
SMALL: dict[str, Any] = {
    "generations": 2,
    "trials": 2,
    "selection_trials": 2,
    "transfer_trials": 3,
    "traces": 2,
    "held_back": 0.3,
    "models": ("linear", "near=nearest_neighbour"),
    "ensembles": ("linear+near",),
    "task": "point_to_point(horizon=60)",
    "strategy": "mu_plus_lambda(children=5)",
}


@pytest.fixture(autouse=True)
def _others_find_the_project(monkeypatch):
    monkeypatch.syspath_prepend(ROOT)


class Remarks(Observer):
    """Keeps the remarks."""

    def __init__(self):
        self.said: list[str] = []

    def remark(self, sentence):
        self.said.append(sentence)


def without_timings(report):
    found = to_json(report)
    assert isinstance(found["timings"], dict)
    found["timings"] = sorted(found["timings"])
    return json.dumps(found)


def test_the_report_is_the_same_for_any_number_of_jobs(tmp_path):
    remarks = Remarks()
    one, two = (
        compare(example_dataset(), out=tmp_path / str(jobs), jobs=jobs, observer=remarks, **SMALL) for jobs in (1, 2)
    )
    assert without_timings(one) == without_timings(two)
    assert remarks.said == []
    written = [json.loads((tmp_path / jobs / "report.json").read_text()) for jobs in "12"]
    for document in written:
        del document["timings"]
    assert written[0] == written[1]


def test_another_process_plans_the_same_cells_of_the_run_folder(tmp_path):
    settings = {**SMALL, "only": None, "preset": "quick", "by_hand": ("pursuit",)}
    compare(example_dataset(), out=tmp_path, **meaningful(settings, {"only": "prediction"}))
    first = plan_comparison(Experiment.of(settings), dataset=example_dataset())
    assert first.plan.again is not None
    again = first.plan.again.plan(tmp_path)
    assert [cell.digest for cell in again] == [cell.digest for cell in first.plan]


def test_the_yardstick_of_a_recorded_run_is_planned_again(tmp_path):
    first = plan_comparison(Experiment.of({"models": ("linear",), "robot": "emulated_car", "minutes": 0.5}))
    data = first.data
    record = Record(
        digest=data.digest, kind=data.kind, title=data.title, name=data.name, status="done", inputs=data.inputs(),
        needs=[], artefact="data/there", versions={}, timings={},
    )  # fmt: skip
    system = make_robot("emulated_car").system
    again = plan_comparison(first.experiment, stored=(StoredCell(record, GivenData), system))
    assert "evolve emulated_car" in [cell.title for cell in again.plan]
    assert [cell.digest for cell in again.plan] == [cell.digest for cell in first.plan]


@pytest.mark.nightly
def test_a_recorded_comparison_with_a_yardstick_is_the_same_for_any_number_of_jobs(tmp_path):
    settings = {
        "models": ("linear", "parametrised", "nearest_neighbour", "mlp_ensemble"),
        "minutes": 1.0,
        "generations": 6,
        "robot": "emulated_car",
    }
    remarks = Remarks()
    one, two = (compare(out=tmp_path / str(jobs), jobs=jobs, observer=remarks, **settings) for jobs in (1, 2))
    assert without_timings(one) == without_timings(two)
    assert remarks.said == []
    again, _ = comparison_again(Experiment.of(Experiment.read(tmp_path / "2")), tmp_path / "2")
    assert "emulated_car" in [champion.name for champion in again.matrix.champions]  # type: ignore[union-attr]
