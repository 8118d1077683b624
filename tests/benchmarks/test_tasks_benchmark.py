"""The command that compares what is achieved with one search on the robot, task by task."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.benchmarks.tasks import main


@pytest.mark.nightly
def test_a_tiny_run_prints_what_is_achieved_beside_one_search_on_the_robot(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tiny = ["--out", str(tmp_path), "--cases", "thermal/set_point", "--seeds", "0", "--minutes", "3"]
    assert main([*tiny, "--generations", "2"]) == 0
    printed = capsys.readouterr().out
    assert "thermal set_point 0 polished of" in " ".join(printed.split())
