"""A real study of two emulated cars and two seeds, from its file to its page, and what disturbs it."""

import json
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from evaluation.running import run_study, write_study
from evaluation.study.figures import controller_figures
from evaluation.study.planning import plan_study, seconds_about
from evaluation.study.results import gather_study
from evaluation.study.study import Study
from sysid_evo.data import Dataset
from sysid_evo.errors import InvalidArgument
from sysid_evo.plan import Observer, Store, execute
from tests.fixtures.cells import number
from tests.fixtures.commands import COMMAND, run_here
from tests.fixtures.session import STUDY
from tests.fixtures.studies import finished, found_in

pytestmark = pytest.mark.usefixtures("blank_figures")


class Computed(Observer):
    """Remembers which cells were computed."""

    def __init__(self):
        self.titles = []

    def start(self, cell):
        self.titles.append(cell.title)


@pytest.fixture(scope="session")
def planned():
    return plan_study(Study.of(STUDY))


def test_recordings_that_several_points_name_are_read_once(stored_data, monkeypatch):
    read, original = [], Dataset.read

    def reading(paths, **options):
        read.append(paths)
        return original(paths, **options)

    monkeypatch.setattr(Dataset, "read", reading)
    experiment = {"data": [str(stored_data)], "models": ["linear"], "stop_after": "prediction"}
    planned = plan_study(Study.of({"experiment": experiment, "grid": {"seed": "0..2"}}))
    assert len(planned.points) == 3
    assert read == [(str(stored_data),)]


def test_cells_that_should_take_no_time_correct_no_estimate():
    cell = number(1)
    records = {cell.digest: SimpleNamespace(status="done", seconds=3.0)}
    assert seconds_about(SimpleNamespace(plan=[replace(cell, expected_seconds=0.0)]), records) == {cell.digest: 0.0}


def test_every_point_has_its_controllers_with_what_they_claim_and_achieve(study_folder, planned):
    results = gather_study(planned, study_folder)
    assert len(results.finished) == 4
    for point in results.points:
        own = [row for row in results.controllers if row.point == point.name]
        assert [row.kind for row in own] == ["single", "single", "ensemble", "polished"]
        assert all(None not in (row.claimed, row.achieved, row.forecast, row.normalised) for row in own)
        assert [row.controller for row in own if row.chosen] == [point.chosen]
        best = max(own, key=lambda row: row.forecast or 0.0)
        assert best.chosen


def test_a_study_weights_a_model_that_fails_the_sanity_check_as_one_run_does(study_folder, planned, monkeypatch):
    """Of two models the one that fails counts as predicting the mean; its error in the tables is the measured one."""
    original = Store.outcome

    def with_warning(text):
        def outcome(store, cell):
            found = original(store, cell)
            failed = cell.kind == "predict" and found.value is not None and found.value.name == "linear"
            return replace(found, value=replace(found.value, warning=text)) if failed else found

        monkeypatch.setattr(Store, "outcome", outcome)
        return gather_study(planned, study_folder).controllers

    plain, warned = with_warning(""), with_warning("linear is worse than no change")
    assert [row.error for row in plain] == [row.error for row in warned]
    assert [row.forecast_low for row in plain] != [row.forecast_low for row in warned]


def test_errors_of_models_are_those_that_were_measured(study_folder, planned):
    results, store, (point, comparison) = gather_study(planned, study_folder), Store(study_folder), planned.points[1]
    rows = {row.model: row for row in results.models if row.point == point.name}
    for name in rows:
        found = store.load(comparison.predictions[name]).scores
        measured = [(one.horizon, one.n, *one.estimate.interval) for one in found]
        assert [(error.horizon, error.n, error.low, error.high) for error in rows[name].errors] == measured
        assert rows[name].seconds
    own = {row.controller: row for row in results.controllers if row.point == point.name}
    both = [name for name, row in own.items() if set(row.members) == set(rows)]
    means = np.mean([rows[name].n(20) for name in rows])
    assert [own[name].error for name in both] == pytest.approx([means] * len(both))
    assert {name: row.aggregate for name, row in own.items() if len(row.members) == 1} == dict.fromkeys(rows, "")
    assert {own[name].aggregate for name in both} == {"min"}


def test_the_yardstick_of_a_robot_is_the_best_over_all_its_points(study_folder, planned):
    results = gather_study(planned, study_folder)
    for where in {point.where for point in results.points}:
        names = {point.name for point in results.points if point.where == where}
        own = [row for row in results.controllers if row.point in names]
        assert {row.best_known for row in own} == {max(row.achieved or 0.0 for row in own)}


def test_a_finished_study_computes_nothing_again(study_folder, tmp_path):
    shutil.copytree(study_folder, tmp_path / "study")
    seen = Computed()
    results = run_study(STUDY, out=tmp_path / "study", observer=seen)
    assert seen.titles == []
    assert not results.failures


def test_a_point_that_is_added_computes_only_what_is_new(study_folder, tmp_path):
    more = {**STUDY, "grid": {**STUDY["grid"], "aggregate": ["min", "mean"], "robot": ["emulated_car"], "seed": "0..0"}}
    more["grid"]["seed"] = [0]
    shutil.copytree(study_folder, tmp_path / "more")
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


def test_a_study_that_is_half_done_shows_what_is_there(study_folder, planned, tmp_path):
    shutil.copytree(study_folder, tmp_path / "half")
    last = planned.comparisons[-1].plan
    for cell in last:
        if cell.kind in ("run", "exploit", "advise"):
            (tmp_path / "half" / "cells" / f"{cell.digest}.json").unlink()
    results = gather_study(planned, tmp_path / "half")
    assert [point.finished for point in results.points] == [True, True, True, False]
    assert not any(row.chosen for row in results.controllers if row.point == results.points[-1].name)


def test_what_emulated_robots_record_is_computed_side_by_side_too(planned):
    assert not any(cell.local for cell in planned.plan)


def test_a_cell_is_named_by_what_the_points_that_need_it_share():
    both = plan_study(Study.of({**STUDY, "grid": {"seed": [0, 1], "aggregate": ["min", "mean"]}}))
    titles = {f"{both.where(cell)}{cell.title}" for cell in both.plan}
    assert "seed 1: fit linear" in titles
    assert "seed 0, aggregate mean: polish the best" in titles


def test_failing_cells_are_rows_with_reasons(tmp_path):
    settings = {
        "models": ["linear", "bad=nearest_neighbour(state_lags=2000)"],
        "minutes": 0.3,
        "stop_after": "prediction",
    }
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


def test_parquet_holds_every_row_with_the_meaning_of_its_columns(study_folder, planned):
    results = gather_study(planned, study_folder)
    rows = {
        "points": results.points,
        "models": results.models,
        "controllers": results.controllers,
        "cells": results.times,
    }
    for name, expected in rows.items():
        table = pq.read_table(study_folder / f"{name}.parquet")
        assert table.num_rows == len(expected)
        assert all(field.metadata and field.metadata[b"description"] for field in table.schema)
    frame = pd.read_parquet(study_folder / "controllers.parquet")
    assert frame["normalised"].max() == 1.0
    assert set(frame["axis_seed"]) == {"0", "1"}
    assert {"n_20", "n_20_low", "n_20_high"} <= set(pd.read_parquet(study_folder / "models.parquet"))


def test_the_document_is_strict_json_and_markdown_has_all_tables(study_folder):
    document = json.loads((study_folder / "study.json").read_text())
    assert document["schema"] == "sysid-evo/study/3"
    assert len(document["points"]) == 4
    text = (study_folder / "study.md").read_text()
    for title in ("In short", "Controllers", "Prediction", "Exploitability", "Forecasts", "Time", "Points"):
        assert f"# {title}" in text
    assert "too few for an interval" in text


def test_a_physical_robot_is_no_point_of_a_study():
    with pytest.raises(InvalidArgument, match="a physical robot, which a study does not drive"):
        plan_study(Study.of({"grid": {"robot": ["serial(port=nowhere)"], "seed": [0]}}))


INTERRUPTIBLE = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
"""Put before a command: a job in the background ignores Ctrl-C."""


def stopped_after(cells, folder, number):
    """Start the command in a process of its own and send it the signal as soon as so many cells are done."""
    command = [sys.executable, "-c", INTERRUPTIBLE + COMMAND[-1], "study", "tiny.toml"]
    with subprocess.Popen(command, cwd=folder, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True) as process:
        deadline = time.monotonic() + 150.0
        while finished(folder / "runs" / "tiny").total() < cells and process.poll() is None:
            assert time.monotonic() < deadline
            time.sleep(0.005)
        process.send_signal(number)
        _, said = process.communicate(timeout=150.0)
    return process.returncode, " ".join(said.split())


@pytest.mark.nightly
def test_a_study_that_is_killed_and_interrupted_goes_on_to_the_same_tables_and_computes_nothing_twice(
    tmp_path, study_folder
):
    Study.of(STUDY).write(tmp_path / "tiny.toml")
    cells, study = len(finished(study_folder)), tmp_path / "runs" / "tiny"
    assert stopped_after(round(0.25 * cells), tmp_path, signal.SIGKILL)[0] == -signal.SIGKILL
    assert 0.25 * cells - 1 < len(finished(study)) < cells
    code, said = stopped_after(round(0.6 * cells), tmp_path, signal.SIGINT)
    assert code == 130
    assert re.search(r"interrupted: \S.*; to continue, repeat the command with --out runs/tiny", said)
    assert "Traceback" not in said
    assert 0.6 * cells - 1 < len(finished(study)) < cells
    assert not [*study.rglob("*.tmp"), *study.rglob("*.json.*"), *study.glob("study.json")]
    last = run_here("study", "tiny.toml", "--out", "runs/tiny", cwd=tmp_path)
    assert last.returncode == 0, last.stderr
    assert finished(study) == finished(study_folder)
    assert set(finished(study).values()) == {1}
    assert found_in(study) == found_in(study_folder)
