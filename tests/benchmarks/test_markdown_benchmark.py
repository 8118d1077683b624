"""A table that a command writes has the form that pages of results include."""

import importlib.util
import re
import sys
from pathlib import Path

import pytest
from rich.table import Table

from tests.benchmarks.markdown import ROOT, print_tables, thousandths

TABLES = sorted((ROOT / "docs/results/tables").glob("*.md"))


def test_a_written_table_names_its_command_commit_and_date(tmp_path, monkeypatch):
    file = tmp_path / "table.md"
    monkeypatch.setattr(sys, "orig_argv", ["python3", "-m", "a.benchmark", "--markdown", str(file), "--seeds", "2"])
    table = Table("car", "N")
    table.add_row("slippery", "0.3")
    print_tables([table], file)
    first, _, *rows = file.read_text().splitlines()
    command, commit, date = first.removeprefix("<!-- ").removesuffix(" -->").split("; ")
    assert command == "python -m a.benchmark --seeds 2"
    assert commit.startswith("commit ")
    assert len(date) == len("2026-01-31")
    assert rows == ["| car | N |", "| --- | --- |", "| slippery | 0.3 |"]


@pytest.mark.parametrize("table", TABLES, ids=lambda path: path.stem)
def test_the_command_of_a_table_of_results_writes_tables(table):
    origin = table.read_text().splitlines()[0]
    for name in re.findall(r"python -m (tests\.[\w.]+)", origin):
        found = importlib.util.find_spec(name)
        assert found is not None, f"{table.name}: there is no command {name}"
        file = Path(found.origin)
        main = file.with_name("__main__.py") if file.name == "__init__.py" else file
        assert "add_markdown(" in main.read_text(), f"{name} has no --markdown"


def test_numbers_of_one_cell_have_three_places_and_no_leading_zero():
    assert thousandths([0.1294, 0.3, 1.25]) == ".129 .300 1.250"
