"""Predicted time of a run on several processes, compared with a manual calculation."""

from __future__ import annotations

from pathlib import Path

import pytest

from sysid_evo.plan import Plan, Store, execute
from tests.benchmarks.scaling import Recorded, copied, critical_path, families, main, makespan, point, recorded
from tests.fixtures.cells import number


def cell(name: str, seconds: float, *needs: str, kind: str = "number", title: str = "") -> Recorded:
    return Recorded(name, kind, title or name, needs, seconds, 1000, 2)


CHAIN = [cell("a", 1.0), cell("b", 2.0, "a"), cell("c", 3.0, "b")]
FORK = [cell("data", 1.0), *(cell(f"fit {i}", 2.0, "data") for i in range(4)), cell("end", 0.5, "fit 0", "fit 3")]


def test_a_chain_takes_as_long_on_many_processes_as_on_one() -> None:
    assert makespan(CHAIN, 1) == makespan(CHAIN, 100) == 6.0
    assert [one.digest for one in critical_path(CHAIN)] == ["a", "b", "c"]


def test_independent_work_is_divided_until_the_longest_chain_is_left() -> None:
    assert makespan(FORK, 1) == 9.5
    assert makespan(FORK, 2) == 5.5  # 1, then two rounds of two fits; the last rounds leave room for the end
    assert makespan(FORK, 4) == makespan(FORK, 50) == 3.5


def test_work_on_which_most_waits_comes_first() -> None:
    late = [cell("short", 1.0), cell("first", 1.0), cell("second", 5.0, "first")]
    assert makespan(late, 1) == 7.0
    assert makespan([*late, cell("third", 4.0)], 2) == 6.0


def test_one_that_hands_out_all_work_in_turn_is_the_limit_of_many_short_cells() -> None:
    short = copied([cell("run", 0.02)], 100)
    assert makespan(short, 1000) == pytest.approx(0.02)
    assert makespan(short, 1000, client=0.01) == pytest.approx(100 * 0.01 + 0.02)


def test_copies_do_not_depend_on_each_other() -> None:
    assert makespan(copied(FORK, 3), 12) == makespan(FORK, 4)


def test_a_point_is_one_comparison_of_several_with_what_they_share() -> None:
    end = [cell(f"advise {i}", 1.0, f"fit {i}", kind="advise") for i in (0, 3)]
    aside = cell("exploit 3", 1.0, "data", "fit 3", kind="exploit")
    found = point([*FORK, *end, aside], 2)
    assert [one.digest for one in found] == ["data", "fit 3", "advise 3", "exploit 3"]
    with pytest.raises(ValueError, match="one of 2 finished comparisons"):
        point([*FORK, *end], 3)


def test_the_records_of_a_run_are_the_plan_with_the_seconds_it_took(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first = number(label="data")
    last = number(3, (first, number(2, (first,), "fit")), "end")
    execute(Plan.of([last]), Store(tmp_path))
    found = recorded(tmp_path)
    assert [len(one.needs) for one in found] == [0, 1, 2]
    assert all(one.size > 0 and one.seconds > 0.0 for one in found)
    assert main([str(tmp_path), "--processes", "1", "2", "--copies", "2", "--client", "0.1"]) == 0
    shown = capsys.readouterr().out
    assert shown.count("| 2      |              0.1 |") == 2
    assert "3 cells" in shown
    assert "count data 0.0, count fit 0.0, count end 0.0" in shown


def test_the_table_of_families_has_medians_of_their_fits_evolutions_and_trials() -> None:
    cells = [cell(f"fit {i}", i, kind="fit", title="fit narx") for i in (1.0, 2.0, 9.0)]
    cells += [cell("a", 4.0, kind="evolve", title="evolve narx"), cell("b", 9.0, kind="evolve", title="evolve x+narx")]
    cells += [cell("c", 0.5, kind="run", title="run pid on narx"), cell("d", 5.0, kind="evolve", title="evolve robot")]
    table = families(cells, 2e8)
    rows = list(zip(*(column.cells for column in table.columns), strict=True))
    assert rows == [("`narx`", "2.0", "4.0", "50", "0.500"), ("`robot`", "", "5.0", "40", "")]


def test_a_folder_without_records_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main([str(tmp_path)])
    assert "expected a run folder with records" in capsys.readouterr().err
