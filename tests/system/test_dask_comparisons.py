"""A comparison on the workers of a Dask cluster that know nothing of its folder: the same in every byte."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections import Counter
from typing import Any

import dask
import numpy as np
import pytest

from evaluation.running import compare
from evaluation.transfer import Cell, MeasuredResult, person, save_measured
from sysid_evo.testing import example_dataset
from tests.fixtures.commands import forgetting, run_here
from tests.fixtures.dask_cluster import Processes
from tests.system.test_comparison_processes import SMALL, Remarks

PLUGIN = '''
import os
from pathlib import Path

from model_zoo.linear import Linear
from sysid_evo.registry import register_model

with (Path(os.environ["PLUGIN_DIARY"])).open("a") as file:
    file.write(f"{os.getpid()} {__file__}\\n")


@register_model("mine")
class Mine(Linear):
    """A family of somebody else."""
'''


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dask")
    made = Processes(folder, environment={"PLUGIN_DIARY": str(folder / "plugins")})
    made.start(2)
    yield made
    made.stop()


def results(folder):
    """Return the files of all results by their path; how long a fit took is left out."""
    places = ("data", "models", "controllers", "results")
    return {
        file.relative_to(folder).as_posix(): re.sub(rb'"fit_seconds": [0-9.e-]+', b"", file.read_bytes())
        for place in places
        for file in (folder / place).rglob("*")
        if file.is_file()
    }


def report(folder):
    found: dict[str, Any] = json.loads((folder / "report.json").read_text())
    del found["timings"]
    return found


def test_a_comparison_is_the_same_in_every_byte(tmp_path, cluster, monkeypatch):
    monkeypatch.setenv("PLUGIN_DIARY", str(tmp_path / "plugins"))
    (tmp_path / "own.py").write_text(PLUGIN)
    settings = {
        **SMALL,
        "models": ("linear", "mine"),
        "ensembles": ("linear+mine",),
        "recipe": "plain",
        "robot": "emulated_car",
        "traces": 1,
        "plugins": (str(tmp_path / "own.py"),),
        "by_hand": ("pursuit",),
    }
    human = MeasuredResult(person("anna"), Cell("anna", "linear", np.array([5.0]), unit="waypoints"), on_robot=False)
    for name, scheduler in (("here", None), ("there", str(cluster.file))):
        (tmp_path / name / "cells").mkdir(parents=True)
        save_measured(tmp_path / name, human)
        remarks = Remarks()
        with forgetting():
            compare(
                example_dataset(), out=tmp_path / name, observer=remarks, scheduler=scheduler,
                jobs=1, **settings,
            )  # fmt: skip
        assert remarks.said == []
    here, there = tmp_path / "here", tmp_path / "there"
    assert results(here) == results(there)
    assert report(here) == report(there)
    lines = [json.loads(line) for line in (there / "log.jsonl").read_text().splitlines()]
    assert set(Counter(line["digest"] for line in lines).values()) == {1}
    loaded = dict(line.split(" ", 1) for line in (cluster.folder / "plugins").read_text().splitlines())
    assert len(loaded) == 2
    assert str(os.getpid()) not in loaded
    assert not any(file.startswith(str(tmp_path)) for file in loaded.values())


def test_a_controller_evolved_against_models_of_the_run_and_of_another_folder_is_the_same(tmp_path, cluster):
    example_dataset().save(tmp_path / "logs")
    for name, models in (("one", "linear,near=nearest_neighbour"), ("two", "far=linear(ridge=0.5)")):
        done = run_here("fit", "logs", "--models", models, "--out", name, "--jobs", "1", cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    shutil.copytree(tmp_path / "one", tmp_path / "three")
    found = []
    for folder, where in (("one", ("--jobs", "1")), ("three", ("--scheduler", str(cluster.file)))):
        (own,) = (tmp_path / folder / "models").glob("linear-*.json")
        ended = run_here(
            "evolve", "--run", folder, "--against", f"{own.relative_to(tmp_path)},two/models/far", "--generations", "2",
            "--trials", "2", "--task", "point_to_point(horizon=40)", "--controller", "recurrent(hidden=2)",
            "--strategy", "mu_plus_lambda(parents=2, children=2)", "--runs", "1", *where, cwd=tmp_path,
        )  # fmt: skip
        assert ended.returncode == 0, ended.stderr
        assert "cannot plan" not in ended.stderr
        found.append(results(tmp_path / folder))
    assert found[0] == found[1]
    log = [json.loads(line) for line in (tmp_path / "three" / "log.jsonl").read_text().splitlines()]
    assert set(Counter(line["digest"] for line in log).values()) == {1}


def test_a_scheduler_that_is_lost_ends_the_command_with_a_sentence_and_a_code(tmp_path):
    example_dataset().save(tmp_path / "logs")
    command = ("fit", "logs", "--models", "linear", "--out", "run", "--scheduler", "tcp://127.0.0.1:9")
    with dask.config.set({"distributed.comm.timeouts.connect": "0.5s"}):
        ended = run_here(*command, cwd=tmp_path)
    assert ended.returncode == 4
    assert "no scheduler answers at tcp://127.0.0.1:9" in " ".join(ended.stderr.split())
    assert "Traceback" not in ended.stderr
