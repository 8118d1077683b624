"""A table that a command writes has the form that pages of results include."""

import sys

from rich.table import Table

from tests.benchmarks.markdown import print_tables


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
