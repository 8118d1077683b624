"""The benchmark of adaptation: its rows, its tables, and that it runs."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.benchmarks.shift import __main__ as benchmark
from tests.benchmarks.shift.recordings import GROUPS, Case
from tests.benchmarks.shift.recordings import cases as cases_of
from tests.benchmarks.shift.rows import Row, errors_table, read_rows, verdicts_table, write_rows
from tests.fixtures.systems import FloorCar, drive


def row(case: str, seed: int = 0, *, shifted: bool = True, ten: float = 1.0, thirty: float, there: float = 0.5) -> Row:
    """A row of a family whose error was 1 before."""
    n = {"before": 1.0, "10 s": ten, "30 s": thirty, "in-domain": there}
    return Row(case, shifted, "linear", "quick", seed, {way: {20: error, 60: 2.0} for way, error in n.items()})


def cells(table: str) -> list[str]:
    """The cells of the last line of a table."""
    return [cell.strip() for cell in table.splitlines()[-1].strip("|").split("|")]


def test_where_something_shifted_the_mean_over_seeds_is_compared_with_the_aims():
    rows = [row("ice", 0, thirty=0.50), row("ice", 1, thirty=0.60), row("mud", thirty=0.59)]
    rows.append(row("sand", thirty=0.70, there=0.65))
    assert cells(verdicts_table(rows))[:9] == ["`linear`", "2", "3", "2", "2", "30 %", "2", "+18 %", "3"]
    assert cells(verdicts_table([*rows, row("oil", thirty=0.70, there=0.60)]))[8] == "3", "neither 40 % nor within 15 %"


def test_where_nothing_shifted_and_after_ten_seconds_the_worst_seed_counts():
    rows = [row("same", 0, shifted=False, thirty=0.8), row("same", 1, shifted=False, ten=1.04, thirty=1.02)]
    assert cells(verdicts_table(rows))[9:] == ["2", "+2 % !", "0", "0", "2", "+4 % !"]
    assert cells(verdicts_table(rows[:1]))[9:] == ["1", "-20 %", "0", "0", "1", "+0 %"]


def test_strongly_shifted_cases_that_were_adapted_after_ten_seconds_are_counted():
    rows = [row("ice", 0, ten=0.7, thirty=0.5), row("ice", 1, thirty=0.5), row("mud", ten=0.9, thirty=0.8, there=0.7)]
    assert cells(verdicts_table(rows))[11:] == ["2", "1", "3", "+0 %"]


def test_each_seed_adapts_to_another_recording_or_to_another_part_of_it():
    new = tuple(drive(FloorCar(), seconds=30.0, seed=seed) for seed in (1, 2))
    case = Case("ice", True, new[0], new, new[0], new[0])
    starts = [case.first(10.0, seed).episodes[0].states[0] for seed in range(4)]
    expected = [new[0].episodes[0].states[0], new[1].episodes[0].states[0]]
    expected += [one.episodes[0].states[200] for one in new]
    np.testing.assert_array_equal(starts, expected)
    assert case.first(10.0, 1).n_steps == 200
    np.testing.assert_array_equal(case.first(30.0, 2).episodes[0].states, new[0].episodes[0].states)


@pytest.mark.parametrize("group", ["emulated", "heater", "pendulum", "cart-pole"])
def test_an_emulated_robot_behaves_differently_in_each_condition(group):
    own, *others = cases_of(group)
    assert not own.shifted
    assert len(others) >= 4
    tests = [case.test.episodes[0].states for case in (own, *others)]
    assert all(case.shifted and case.training is not None for case in others)
    spread = tests[0].std(axis=0)
    for states in tests[1:]:
        assert (np.abs(states - tests[0]).mean(axis=0) > 0.02 * spread).any()


def test_rows_of_several_files_are_put_together_and_the_later_one_counts(tmp_path: Path) -> None:
    first, second = tmp_path / "a.json", tmp_path / "b.json"
    write_rows(first, [row("ice", thirty=0.5), row("sand", thirty=0.5)])
    write_rows(second, [row("ice", thirty=0.6), row("ice", 1, thirty=0.6)])
    found = read_rows([first, second])
    assert [(one.case, one.seed, one.at("30 s")) for one in found] == [
        ("ice", 0, 0.6),
        ("sand", 0, 0.5),
        ("ice", 1, 0.6),
    ]
    assert found[2] == row("ice", 1, thirty=0.6)


def test_the_figures_of_four_cases_stand_abreast_and_what_was_not_measured_is_a_dash() -> None:
    others = [row(f"floor {i}", thirty=0.6) for i in range(4)]
    wide, narrow = errors_table([row("ice", 0, thirty=0.5), row("ice", 1, thirty=0.6), *others]).split("\n\n")
    assert cells(wide)[:2] == ["`linear`", "1.00 1.00 .55 - .50"]
    assert narrow.splitlines()[0] == "| family | floor 3 |"


def test_a_run_writes_a_row_for_each_seed_and_says_how_the_family_stands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def ice() -> Iterator[Case]:
        there = FloorCar(thrust=1.5, turn=2.0)
        new, own, test = (drive(there, seconds=30.0, seed=seed) for seed in (1, 2, 3))
        yield Case("ice", True, drive(FloorCar(), seconds=30.0, seed=0), (new,), own, test)

    monkeypatch.setitem(GROUPS, "floors", ice)
    out = tmp_path / "rows.json"
    options = ["linear", "--groups", "floors", "--seeds", "2", "--ways", "30 s", "in-domain", "--out", str(out)]
    assert benchmark.main(options) == 0
    said = capsys.readouterr().out
    rows = read_rows([out])
    assert [one.seed for one in rows] == [0, 1]
    assert set(rows[0].n) == {"before", "30 s", "in-domain"}
    assert rows[0].at("30 s") < rows[0].at("before")
    assert rows[0].note in said
    assert benchmark.main(["--read", str(out)]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == said.splitlines()[-1]
