"""The contract of readers: all that are listed keep it, each broken one is caught with its sentence."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from hardware.connection import Command, Measurement
from hardware.recording.journal import Recorder
from sysid_evo.data.readers import Reader, Table
from sysid_evo.errors import ContractViolation, InvalidArgument, InvalidData
from sysid_evo.registry import readers
from sysid_evo.testing import check_reader, example_systems, run_reader_checks
from sysid_evo.testing import readers as kit
from tests.broken import broken, sentence

ROWS = [{"t": 0.05 * i, "speed": float(i % 7), "note": None if i == 3 else 1.0} for i in range(10)]


class JsonLines(Reader):
    """A sound one: an object on every line; rows are numbered by line."""

    suffixes: tuple[str, ...] = (".jsonl",)  # type: ignore[misc]  # one below changes it

    def header(self, path: Path) -> tuple[str, ...]:
        return tuple(self.objects(path)[0])

    def read(self, path: Path, columns: Sequence[str]) -> Table:
        objects = self.objects(path)
        data = {name: self.column(path, objects, name) for name in columns}
        return Table(path, np.arange(1, len(objects) + 1), data)

    def objects(self, path: Path) -> list[dict[str, float | None]]:
        try:
            found = [json.loads(line) for line in path.read_text().splitlines()]
        except ValueError as error:
            raise InvalidData(f"{path.name}: not a JSON object on every line: {error}") from error
        if len(found) < 2:
            raise InvalidData(f"{path.name}: expected two rows or more")
        return found

    def column(self, path: Path, objects: list[dict[str, float | None]], name: str) -> np.ndarray[Any, Any]:
        if name not in objects[0]:
            raise InvalidData(f"{path.name}: column {name!r} is missing")
        values = np.array([item[name] for item in objects], dtype=np.float64)
        if not np.isfinite(values).all():
            raise InvalidData(f"{path.name}: column {name!r} has a hole")
        return values


class UpperCase(JsonLines):
    suffixes = (".JSONL",)


class Greedy(JsonLines):
    suffixes = (".jsonl", ".csv")


class ListOfNames(JsonLines):
    def header(self, path: Path) -> tuple[str, ...]:
        return list(super().header(path))  # type: ignore[return-value]  # what is tested


class OrderOfTheFile(JsonLines):
    def read(self, path: Path, columns: Sequence[str]) -> Table:
        return super().read(path, [name for name in self.header(path) if name in columns] or columns)


class Unnumbered(JsonLines):
    def read(self, path: Path, columns: Sequence[str]) -> Table:
        table = super().read(path, columns)
        return Table(path, np.ones_like(table.rows), table.columns)


class Dropping(JsonLines):
    """Leaves out the rows in which a column that is asked for has a hole."""

    def read(self, path: Path, columns: Sequence[str]) -> Table:
        objects = self.objects(path)
        whole = [item for item in objects if all(item.get(name, 0.0) is not None for name in columns)]
        data = {name: self.column(path, whole, name) for name in columns}
        return Table(path, np.arange(1, len(whole) + 1), data)


class Curt(JsonLines):
    def column(self, path: Path, objects: list[dict[str, float | None]], name: str) -> np.ndarray[Any, Any]:
        if name not in objects[0]:
            raise InvalidData(f"{path.name}: a column is missing")
        return super().column(path, objects, name)


class Raw(JsonLines):
    def objects(self, path: Path) -> list[dict[str, float | None]]:
        return super().objects(path) if path.stat().st_size else []


class Trusting(JsonLines):
    """Takes what JSON gives for numbers."""

    def column(self, path: Path, objects: list[dict[str, float | None]], name: str) -> np.ndarray[Any, Any]:
        if name not in objects[0]:
            raise InvalidData(f"{path.name}: column {name!r} is missing")
        values = [item[name] for item in objects]
        if None in values:
            raise InvalidData(f"{path.name}: column {name!r} has a hole")
        return np.array(values, dtype=np.float64)


class Filling(JsonLines):
    """Makes up the row in which a file ends."""

    def read(self, path: Path, columns: Sequence[str]) -> Table:
        text = path.read_bytes()
        if not text.startswith(b"{") or text.endswith(b"}"):
            return super().read(path, columns)
        whole = path.with_name(f"whole-{path.name}")
        whole.write_bytes(text[: text.rindex(b"\n")])
        table = super().read(whole, columns)
        return Table(path, table.rows, {name: np.append(values[:-1], np.nan) for name, values in table.columns.items()})


class Tidying(JsonLines):
    def objects(self, path: Path) -> list[dict[str, float | None]]:
        found = super().objects(path)
        path.write_text(path.read_text() + " ")
        return found


BROKEN: list[tuple[type[Reader], Callable[..., None], str]] = [
    (UpperCase, kit.it_names_its_suffixes, r"expected suffixes such as \('.log',\), got \('.JSONL',\)"),
    (Greedy, kit.no_other_reader_has_its_suffixes, ".csv belong to reader 'csv' too"),
    (ListOfNames, kit.the_header_names_the_columns, "expected a tuple of names, got"),
    (OrderOfTheFile, kit.read_gives_finite_numbers, "asked for speed, t, got t, speed"),
    (Unnumbered, kit.rows_are_numbered, "the numbers of the rows do not rise"),
    (Dropping, kit.a_column_does_not_depend_on_the_others, "column 't' alone differs"),
    (Curt, kit.a_missing_column_is_named, "expected 'a column that no file has' in"),
    (Raw, kit.a_damaged_file_is_told, "IndexError"),
    (Trusting, kit.a_wrong_number_is_told, "nan in the place of a number: expected InvalidData, got other numbers"),
    (Filling, kit.a_file_that_is_cut_short_gives_no_wrong_numbers, "of a file that is cut short: expected finite"),
    (Tidying, kit.the_file_is_left_alone, "the file has changed"),
]


@pytest.fixture
def lines(tmp_path: Path) -> Path:
    path = tmp_path / "drive.jsonl"
    path.write_text("\n".join(json.dumps(row) for row in ROWS))
    return path


def a_csv(folder: Path) -> Path:
    path = folder / "drive.csv"
    pd.DataFrame(ROWS).drop(columns="note").to_csv(path, index=False)
    return path


def a_parquet(folder: Path) -> Path:
    path = folder / "drive.parquet"
    pd.DataFrame(ROWS).to_parquet(path)
    return path


def a_journal(folder: Path) -> Path:
    path = folder / "drive.rcj"
    with Recorder(path, example_systems()[0], robot="toy", body="car") as recorder:
        for number in range(40):
            time = 5.0 + 0.005 * number
            pose = np.array([0.005 * number, -2.0, 0.5])
            recorder.measured(Measurement(time, time + 0.004, number, "car", True, pose))
            if number % 10 == 0:
                recorder.commanded(Command(number // 10, time, time, np.array([1.0, -1.0])))
    return path


EXAMPLES = {"csv": a_csv, "parquet": a_parquet, "journal": a_journal}


@pytest.mark.parametrize("name", readers.names())
def test_every_reader_keeps_every_sentence(name: str, tmp_path: Path) -> None:
    check_reader(name, EXAMPLES[name](tmp_path))


def test_a_sound_reader_keeps_every_sentence(lines: Path, register: Callable[..., Any]) -> None:
    register(readers, "lines", JsonLines)
    results = list(run_reader_checks("lines", lines))
    assert broken(results) == {}
    assert len(results) == 1 + len(kit.CHECKS)


@pytest.mark.parametrize(("made", "check", "reason"), BROKEN)
def test_a_broken_reader_is_caught_with_the_one_sentence_it_breaks(
    made: type[Reader], check: Callable[..., None], reason: str, lines: Path, register: Callable[..., Any]
) -> None:
    register(readers, "broken", made)
    found = broken(run_reader_checks("broken", lines))
    assert list(found) == [sentence(check)]
    with pytest.raises(ContractViolation, match=f"reader 'broken' breaks 1 of .*\n- .*{reason}"):
        check_reader("broken", lines)


def test_every_sentence_has_something_that_breaks_it() -> None:
    assert {check for _, check, _ in BROKEN} == set(kit.CHECKS)


def test_a_reader_is_not_checked_without_a_file(tmp_path: Path) -> None:
    with pytest.raises(InvalidArgument, match="reader 'csv': expected a file of its kind to read, found none at"):
        check_reader("csv", tmp_path / "nothing.csv")
