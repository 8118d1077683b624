"""The short version of the command that kills comparisons and evolutions."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.benchmarks.kill_and_resume import rows


@pytest.mark.nightly
def test_what_is_killed_twice_goes_on_to_the_same_result(tmp_path: Path) -> None:
    table = rows(tmp_path, times=2, seed=0)
    assert [row.same for row in table] == [True] * 9
    assert sum(row.kills for row in table) > 0
