"""The command that shows what evolution does not compute."""

from __future__ import annotations

import pytest

from tests.benchmarks import waste


@pytest.mark.slow
def test_a_tiny_run_spares_rollouts_and_changes_nothing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(waste, "FITTED", ("linear", "nearest_neighbour"))
    monkeypatch.setattr(waste, "RECORDED_TIME", 40.0)
    waste.main(["--generations", "5", "--repeats", "1"])
    printed = capsys.readouterr().out
    assert " yes " in printed
    assert "asking and telling niches" in printed
