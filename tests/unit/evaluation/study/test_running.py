"""A real study of two emulated cars and two seeds, from its file to its page."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pandas as pd
import pytest

from evaluation.running import run_study, write_study
from evaluation.study import Study, StudyResults, controller_figures, gather, plan_study
from sysid_evo.errors import InvalidArgument
from sysid_evo.plan import Again, Observer, Store, execute

TINY: dict[str, Any] = {
    "title": "Tiny",
    "experiment": {
        "models": ["linear", "nearest_neighbour"],
        "minutes": 0.5,
        "generations": 2,
        "polish": 1,
        "trials": 2,
        "selection_trials": 2,
        "transfer_trials": 3,
        "traces": 0,
        "yardstick": False,
        "task": "point_to_point(horizon=60)",
        "strategy": "mu_plus_lambda(children=5)",
    },
    "grid": {"robot": ["emulated_car", "emulated_car(seed=1)"], "seed": "0..1"},
}


class Computed(Observer):
    """Remembers which cells were computed."""

    def __init__(self):
        self.titles: list[str] = []

    def start(self, cell):
        self.titles.append(cell.title)


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    """The folder of a finished study."""
    path = tmp_path_factory.mktemp("study") / "tiny"
    run_study(TINY, out=path, jobs=1)
    return path


@pytest.fixture(scope="session")
def planned():
    return plan_study(Study.of(TINY))


def test_every_point_has_its_controllers_with_what_they_claim_and_achieve(folder, planned):
    results = gather(planned, folder)
    assert len(results.finished) == 4
    for point in results.points:
        own = [row for row in results.controllers if row.point == point.name]
        assert [row.kind for row in own] == ["single", "single", "ensemble", "polished"]
        assert all(None not in (row.claimed, row.achieved, row.forecast, row.share) for row in own)
        assert [row.controller for row in own if row.chosen] == [point.chosen]
        best = max(own, key=lambda row: row.forecast or 0.0)
        assert best.chosen


def test_errors_of_models_are_those_that_were_measured(folder, planned):
    results, store, (point, comparison) = gather(planned, folder), Store(folder), planned.points[1]
    rows = {row.model: row for row in results.models if row.point == point.name}
    for name in rows:
        found = store.load(comparison.predictions[name]).at
        measured = [(one.horizon, one.n, one.interval.low, one.interval.high) for one in found]
        assert [(error.horizon, error.n, error.low, error.high) for error in rows[name].errors] == measured
        assert rows[name].seconds
    own = {row.controller: row for row in results.controllers if row.point == point.name}
    both = [name for name, row in own.items() if set(row.members) == set(rows)]
    means = np.mean([rows[name].n(20) for name in rows])
    assert [own[name].error for name in both] == pytest.approx([means] * len(both))
    assert {name: row.aggregate for name, row in own.items() if len(row.members) == 1} == dict.fromkeys(rows, "")
    assert {own[name].aggregate for name in both} == {"min"}


def test_the_yardstick_of_a_robot_is_the_best_over_all_its_points(folder, planned):
    results = gather(planned, folder)
    for where in {point.where for point in results.points}:
        names = {point.name for point in results.points if point.where == where}
        own = [row for row in results.controllers if row.point in names]
        assert {row.yardstick for row in own} == {max(row.achieved or 0.0 for row in own)}


def test_a_finished_study_computes_nothing_again(folder):
    seen = Computed()
    results = run_study(TINY, out=folder, observer=seen)
    assert seen.titles == []
    assert not results.failures


def test_a_point_that_is_added_computes_only_what_is_new(folder, tmp_path):
    import shutil

    more = {**TINY, "grid": {**TINY["grid"], "aggregate": ["min", "mean"], "robot": ["emulated_car"], "seed": "0..0"}}
    more["grid"]["seed"] = [0]
    shutil.copytree(folder, tmp_path / "more")
    seen = Computed()
    execute(plan_study(Study.of(more)).plan, Store(tmp_path / "more"), observer=seen)
    assert seen.titles
    assert not any(title.startswith(("record", "fit", "predict")) for title in seen.titles)


def test_a_study_without_results_says_what_is_missing(planned, tmp_path):
    results = write_study(planned, tmp_path)
    assert not results.finished
    assert sum(point.missing for point in results.points) == len(planned.plan)
    assert not controller_figures(results)
    assert "4 of 4 points are not finished" in (tmp_path / "study.md").read_text()


def test_a_study_that_is_half_done_shows_what_is_there(folder, planned, tmp_path):
    import shutil

    shutil.copytree(folder, tmp_path / "half")
    last = planned.comparisons[-1].plan
    for cell in last:
        if cell.kind in ("run", "exploit", "advise"):
            (tmp_path / "half" / "cells" / f"{cell.digest}.json").unlink()
    results = gather(planned, tmp_path / "half")
    assert [point.finished for point in results.points] == [True, True, True, False]
    assert not any(row.chosen for row in results.controllers if row.point == results.points[-1].name)


def test_the_same_plan_is_made_again_from_its_settings(planned, tmp_path):
    again = planned.plan.again
    assert again is not None
    told = json.loads(json.dumps(again.settings))
    made = Again(again.function, told).plan(tmp_path)
    assert [cell.digest for cell in made] == [cell.digest for cell in planned.plan]
    assert again.after == ()  # what emulated robots record is computed side by side, too


def test_a_cell_is_named_by_what_the_points_that_need_it_share():
    both = plan_study(Study.of({**TINY, "grid": {"seed": [0, 1], "aggregate": ["min", "mean"]}}))
    titles = {f"{both.where(cell)}{cell.title}" for cell in both.plan}
    assert "seed 1: fit linear" in titles
    assert "seed 0, aggregate mean: polish the best" in titles


def test_failing_cells_are_rows_with_reasons(tmp_path):
    settings = {"models": ["linear", "bad=nearest_neighbour(state_lags=2000)"], "minutes": 0.5, "only": "prediction"}
    results = run_study({"experiment": settings, "grid": {"seed": [0, 1]}}, out=tmp_path / "failing", jobs=1)
    failed = [row for row in results.models if row.reason]
    assert [row.model for row in failed] == ["bad", "bad"]
    assert {one.cell for one in results.failures} == {"fit bad"}
    assert "1 failed" not in failed[0].reason
    assert [row.seconds for row in failed] == [None, None]
    assert all(row.seconds for row in results.models if not row.reason)
    assert [one.failed for one in results.times if one.kind == "fit"] == [False, True] * 2
    assert [(point.missing, point.failed, point.finished) for point in results.points] == [(0, 2, True)] * 2
    assert "Failures" in (tmp_path / "failing" / "study.html").read_text()


def test_parquet_holds_every_row_with_the_meaning_of_its_columns(folder, planned):
    import pyarrow.parquet as pq

    results: StudyResults = gather(planned, folder)
    rows = {
        "points": results.points,
        "models": results.models,
        "controllers": results.controllers,
        "cells": results.times,
    }
    for name, expected in rows.items():
        table = pq.read_table(folder / f"{name}.parquet")
        assert table.num_rows == len(expected)
        assert all(field.metadata and field.metadata[b"description"] for field in table.schema)
    frame = pd.read_parquet(folder / "controllers.parquet")
    assert frame["share"].max() == 1.0
    assert set(frame["axis_seed"]) == {"0", "1"}
    assert {"n_20", "n_20_low", "n_20_high"} <= set(pd.read_parquet(folder / "models.parquet"))


def test_the_document_is_strict_json_and_markdown_has_all_tables(folder):
    document = json.loads((folder / "study.json").read_text())
    assert document["schema"] == "sysid-evo/study/1"
    assert len(document["points"]) == 4
    text = (folder / "study.md").read_text()
    for title in ("In short", "Controllers", "Prediction", "Exploitability", "Forecasts", "Time", "Points"):
        assert f"# {title}" in text
    assert "too few for an interval" in text


def test_a_physical_robot_is_no_point_of_a_study():
    with pytest.raises(InvalidArgument, match="a physical robot, which a study does not drive"):
        plan_study(Study.of({"grid": {"robot": ["serial(port=nowhere)"], "seed": [0]}}))
