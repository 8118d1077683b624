"""The command that measures what descriptors of behaviour cost."""

from __future__ import annotations

import pytest

from tests.benchmarks.descriptors import main


@pytest.mark.slow
def test_a_quick_run_measures_the_engine_with_and_without_counting(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--quick", "--models", "nearest"]) == 0
    assert "counting" in capsys.readouterr().out
