"""A study that is killed, interrupted, or computed on a cluster: the same as one that is left alone."""

import json
import re
import signal
import subprocess
import sys
import time
from collections import Counter

import pyarrow.parquet as pq
import pytest

from tests.fixtures.commands import run_here
from tests.fixtures.dask_cluster import LIMIT, Processes

STUDY = """
title = "Small"

[experiment]
models = ["linear", "nearest_neighbour"]
minutes = 0.3
generations = 4
recipe = "plain"
trials = 2
selection_trials = 2
transfer_trials = 3
traces = 0
yardstick = false
task = "point_to_point(horizon=60)"
strategy = "mu_plus_lambda(children=5)"

[grid]
robot = ["emulated_car", "emulated_car(seed=1)"]
seed = [0]
"""
COMMAND = ("study", "small.toml", "--jobs", "1")
PRESSABLE = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background ignores it
from sysid_evo.__main__ import main
main()
"""


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The folder of the study that nothing disturbs."""
    folder = placed(tmp_path_factory.mktemp("whole"))
    done = run_here(*COMMAND, cwd=folder)
    assert done.returncode == 0, done.stderr
    return results_of(folder)


def placed(folder):
    (folder / "small.toml").write_text(STUDY)
    return folder


def results_of(folder):
    """Return where the command, called in ``folder``, puts the study."""
    return folder / "runs" / "small"


def finished(study):
    """Return how often each cell was computed to its end."""
    log = study / "log.jsonl"
    lines = [json.loads(line) for line in log.read_text().splitlines()] if log.is_file() else []
    return Counter(line["digest"] for line in lines if line["status"] == "done")


def timeless(value):
    """Return a part of a document without what is measured by a clock."""
    if isinstance(value, dict):
        return {key: timeless(one) for key, one in value.items() if key not in ("timings", "seconds")}
    return [timeless(one) for one in value] if isinstance(value, list) else value


def found_in(study):
    """Return all that the study says, but for what is measured by a clock."""
    tables = ("points", "models", "controllers", "cells")
    rows = {name: timeless(pq.read_table(study / f"{name}.parquet").to_pylist()) for name in tables}
    return {**rows, "study.json": timeless(json.loads((study / "study.json").read_text()))}


def stopped_after(cells, folder, number):
    """Start the command in a process of its own and send it the signal as soon as so many cells are done."""
    command = [sys.executable, "-c", PRESSABLE, *COMMAND]
    with subprocess.Popen(command, cwd=folder, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True) as process:
        deadline = time.monotonic() + LIMIT
        while finished(results_of(folder)).total() < cells and process.poll() is None:
            assert time.monotonic() < deadline
            time.sleep(0.005)
        process.send_signal(number)
        _, said = process.communicate(timeout=LIMIT)
    return subprocess.CompletedProcess(command, process.returncode, "", said)


def test_a_study_that_is_killed_goes_on_to_the_same_tables_and_computes_nothing_twice(tmp_path, whole):
    cells, study = len(finished(whole)), results_of(placed(tmp_path))
    for share in (0.25, 0.6):
        assert stopped_after(round(share * cells), tmp_path, signal.SIGKILL).returncode == -signal.SIGKILL
        assert share * cells - 1 < len(finished(study)) < cells
        assert not (study / "study.json").exists()
    last = run_here(*COMMAND, cwd=tmp_path)
    assert last.returncode == 0, last.stderr
    assert finished(study) == finished(whole)
    assert set(finished(study).values()) == {1}
    assert found_in(study) == found_in(whole)


def test_ctrl_c_ends_a_study_with_how_to_go_on(tmp_path, whole):
    cells, study = len(finished(whole)), results_of(placed(tmp_path))
    stopped = stopped_after(cells // 2, tmp_path, signal.SIGINT)
    assert stopped.returncode == 130
    said = " ".join(stopped.stderr.split())
    assert re.search(r"interrupted: \S.*; go on with --out runs/small", said)
    assert "Traceback" not in said
    assert not [*study.rglob("*.tmp"), *study.rglob("*.json.*")]
    again = run_here(*COMMAND, "--out", "runs/small", cwd=tmp_path)
    assert again.returncode == 0, again.stderr
    assert finished(study) == finished(whole)
    assert found_in(study) == found_in(whole)


def test_a_study_on_a_cluster_has_the_tables_of_one_process(tmp_path, whole):
    (tmp_path / "dask").mkdir()
    cluster = Processes(tmp_path / "dask")
    try:
        cluster.start(2)
        done = run_here(*COMMAND[:2], "--scheduler", str(cluster.file), cwd=placed(tmp_path))
    finally:
        cluster.stop()
    assert done.returncode == 0, done.stderr
    assert "cannot plan" not in done.stderr
    assert finished(results_of(tmp_path)) == finished(whole)
    assert found_in(results_of(tmp_path)) == found_in(whole)
