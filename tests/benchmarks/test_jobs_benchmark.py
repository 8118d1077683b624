"""The short version of the command that times comparisons with one job and with several."""

from __future__ import annotations

import pytest

from tests.benchmarks.jobs import main


@pytest.mark.nightly
def test_a_small_comparison_with_one_job_and_with_two_is_timed_and_has_one_report(
    capsys: pytest.CaptureFixture[str],
) -> None:
    small = ["--models", "linear,parametrised", "--minutes", "0.5", "--stop-after", "prediction"]
    assert main(["--jobs", "1", "2", "--", *small]) == 0
    shown = capsys.readouterr().out
    assert "2 jobs" in shown
    assert "report.json is the same for any number of jobs" in shown
