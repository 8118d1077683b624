"""Run folders: the same settings come back, other ones are refused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from sysid_evo.errors import ArtefactError, InvalidArgument
from sysid_evo.files import write_atomically
from sysid_evo.store import RunFolder

SETTINGS = {"seed": 3, "families": ["linear", "parametrised"], "limit": None, "evolution": {"trials": 10, "runs": None}}


def test_a_run_is_returned_to_with_the_same_settings(tmp_path: Path) -> None:
    run = RunFolder.open(tmp_path / "runs" / "a", SETTINGS)
    assert run.cells() == {}
    run.record("fit linear-3", seconds=1.5)
    again = RunFolder.open(tmp_path / "runs" / "a", {**SETTINGS, "families": ("linear", "parametrised")})
    assert again.cells() == {"fit linear-3": {"status": "done", "reason": None, "timings": {"seconds": 1.5}}}


@pytest.mark.parametrize(
    "other, named",
    [
        ({"seed": 4}, "seed"),
        ({"families": ["linear"]}, "families"),
        ({"evolution": {"trials": 11}}, "evolution"),
        ({"new": 1, "seed": 5}, "new, seed"),
        ({"seed": None}, "seed"),
    ],
)
def test_a_folder_that_holds_another_run_is_refused(tmp_path: Path, other: dict, named: str) -> None:
    RunFolder.open(tmp_path, SETTINGS).record("a", seconds=0.0)
    with pytest.raises(InvalidArgument, match=f"{tmp_path} holds another run: {named} differ. Choose another folder"):
        RunFolder.open(tmp_path, {**SETTINGS, **other})
    assert RunFolder.open(tmp_path, SETTINGS).cells()


def test_a_failed_cell_keeps_its_reason_until_it_is_done(tmp_path: Path) -> None:
    run = RunFolder.open(tmp_path, SETTINGS)
    run.record("a", seconds=1.0, reason="too little data")
    run.record("b", seconds=2.0)
    assert run.cells()["a"]["status"] == "failed"
    assert run.cells()["a"]["reason"] == "too little data"
    run.record("a", seconds=3.0)
    assert {cell: entry["status"] for cell, entry in run.cells().items()} == {"a": "done", "b": "done"}
    log = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert [(line["cell"], line["status"]) for line in log] == [("a", "failed"), ("b", "done"), ("a", "done")]


def test_the_status_names_the_versions_and_keeps_timings_apart(tmp_path: Path) -> None:
    run = RunFolder.open(tmp_path, SETTINGS)
    run.record("a", seconds=1.0)
    status = json.loads((tmp_path / "run.json").read_text())
    assert "numpy" in status["versions"]
    assert set(status["cells"]["a"]) == {"status", "reason", "timings"}


def test_models_and_controllers_stand_apart_with_their_seeds(tmp_path: Path) -> None:
    run = RunFolder(tmp_path)
    assert run.model("linear", 3) == tmp_path / "models" / "linear-3"
    assert run.controller("mm1", 4) == tmp_path / "controllers" / "mm1-4"


@pytest.mark.parametrize("content", ["", "{", "[]", '{"versions": {}}'])
def test_a_damaged_status_is_named(tmp_path: Path, content: str) -> None:
    run = RunFolder.open(tmp_path, SETTINGS)
    (tmp_path / "run.json").write_text(content)
    with pytest.raises(ArtefactError, match=r"run.json: not a readable status file"):
        run.cells()


def test_damaged_settings_are_named(tmp_path: Path) -> None:
    RunFolder.open(tmp_path, SETTINGS)
    (tmp_path / "experiment.toml").write_text("seed = ")
    with pytest.raises(ArtefactError, match=r"experiment.toml: not a readable TOML file"):
        RunFolder.open(tmp_path, SETTINGS)


def test_a_crash_while_writing_leaves_the_older_file_whole(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "file.txt"
    write_atomically(path, lambda temporary: temporary.write_text("old"))

    def crash(temporary: Path) -> None:
        temporary.write_text("half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_atomically(path, crash)
    assert path.read_text() == "old"
    assert [entry.name for entry in path.parent.iterdir()] == ["file.txt"]
