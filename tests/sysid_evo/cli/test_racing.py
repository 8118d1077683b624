"""Controllers against each other, on the command line."""

from __future__ import annotations

import json
from pathlib import Path

from tests.sysid_evo.cli.calling import run_here


def test_what_was_evolved_in_races_is_stored_and_meets_again(logs: Path, tmp_path: Path) -> None:
    assert run_here("fit", logs, "--models", "linear", "--out", "mine", cwd=tmp_path).returncode == 0
    race = ("--task", "duel(horizon=20)")
    options = ("--generations", "2", "--trials", "1", "--json", *race)
    evolved = run_here("coevolve", "--run", "mine", "--against", "linear", *options, cwd=tmp_path)
    assert evolved.returncode == 0, evolved.stderr
    files = [row["file"] for row in json.loads(evolved.stdout)]
    assert [Path(file).stem for file in files] == ["rival-1", "rival-2"]
    assert not list((tmp_path / "mine" / "controllers").glob("*.checkpoint"))
    met = run_here("match", *files, "--trials", "6", *race, cwd=tmp_path)
    assert met.returncode == 0, met.stderr
    assert "% of 6 races against rival-2" in met.stdout


def test_what_cannot_race_is_told_in_a_sentence(tmp_path: Path) -> None:
    refused = run_here("coevolve", "--against", "emulated_car", "--task", "walled_track", cwd=tmp_path)
    assert refused.returncode == 2
    assert "rivals race at duel(...), got the task walled_track" in " ".join(refused.stderr.split())
    assert not (tmp_path / "runs").exists()
    missing = run_here("match", "a.json", "b.json", cwd=tmp_path)
    assert missing.returncode == 2
