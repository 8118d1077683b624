"""A comparison on the workers of a Dask cluster that know nothing of its folder: the same in every byte."""

from __future__ import annotations

import json
import os
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from evaluation.comparison import compare
from evaluation.transfer import Cell, Measured, person, save_measured
from sysid_evo.testing import example_dataset
from tests.evaluation.test_side_by_side import SMALL, Remarks
from tests.sysid_evo.cli.calling import forgetting
from tests.sysid_evo.plan.dask_processes import Processes

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
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Processes]:
    folder = tmp_path_factory.mktemp("dask")
    made = Processes(folder, environment={"PLUGIN_DIARY": str(folder / "plugins")})
    made.start(2)
    yield made
    made.stop()


def results(folder: Path) -> dict[str, bytes]:
    """Return the files of all results by their path; how long a fit took is left out."""
    places = ("data", "models", "controllers", "results")
    return {
        file.relative_to(folder).as_posix(): re.sub(rb'"fit_seconds": [0-9.e-]+', b"", file.read_bytes())
        for place in places
        for file in (folder / place).rglob("*")
        if file.is_file()
    }


def report(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "report.json").read_text())
    del found["timings"]
    return found


def test_a_comparison_is_the_same_in_every_byte(
    tmp_path: Path, cluster: Processes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PLUGIN_DIARY", str(tmp_path / "plugins"))
    (tmp_path / "own.py").write_text(PLUGIN)
    settings = {
        **SMALL,
        "models": ("linear", "near=nearest_neighbour", "mine"),
        "plugins": (str(tmp_path / "own.py"),),
        "by_hand": ("pursuit",),
    }
    human = Measured(person("anna"), Cell("anna", "linear", np.array([5.0]), unit="waypoints"), on_robot=False)
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
