"""Readers: a file of columns becomes arrays of finite numbers, each with its row in the file."""

from __future__ import annotations

import csv
import math
from abc import ABC, abstractmethod
from array import array
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from sysid_evo.errors import InvalidData, closest
from sysid_evo.registry.registry import readers, register_reader
from sysid_evo.types import Array, IntArray

LEAVE_OUT = (
    "Leave such rows out before importing (where a file has time stamps it is then split there), or fill them yourself."
)
WORDS = "A command in words needs the number of each in the column map: words = {stop = 0.0, go = 1.0} (docs/data.md)."


@dataclass(frozen=True)
class Table:
    """N rows of named columns (N,); ``rows`` (N,) are their numbers in the file ``path``."""

    path: Path
    rows: IntArray
    columns: Mapping[str, Array]

    def __len__(self) -> int:
        return len(self.rows)

    def where(self, column: str, row: int) -> str:
        """Return the place of an entry in words; ``row`` counts from 0 in this table."""
        return f"{self.path.name}, row {self.rows[row]}, column {column!r}"


class Reader(ABC):
    """Reads one kind of file, told by its suffix."""

    suffixes: ClassVar[tuple[str, ...]]

    @abstractmethod
    def header(self, path: Path) -> tuple[str, ...]:
        """Return the names of the columns."""

    @abstractmethod
    def read(self, path: Path, columns: Sequence[str]) -> Table:
        """Return these columns. Raises `InvalidData`, which names file, row and column."""

    def labels(self, path: Path, column: str) -> list[str]:
        """Return what a column calls each row that `read` returns; here its numbers, as texts."""
        return [f"{value:g}" for value in self.read(path, [column]).columns[column]]


@register_reader("csv")
class CsvReader(Reader):
    """Text with one header line; separated by comma, semicolon or tab.

    Rows are numbered as an editor does: the header is row 1. A flawless file is parsed by pyarrow; a
    file that it refuses is read line by line, to name what is wrong with which row.
    """

    suffixes = (".csv", ".txt", ".tsv")

    def header(self, path: Path) -> tuple[str, ...]:
        line = _first_line(path)
        names = tuple(name.strip() for name in next(csv.reader([line], delimiter=_delimiter(line)), []))
        if not any(names):
            raise InvalidData(f"{path.name}: expected a header line with the names of the columns, the file is empty")
        return names

    def read(self, path: Path, columns: Sequence[str]) -> Table:
        header = self.header(path)
        places = [_place(name, header, path) for name in columns]
        values = _parsed(path, _delimiter(_first_line(path)), len(header), places)
        if values is None:
            return self._line_by_line(path, columns, header, places)
        rows = np.arange(2, len(values[0]) + 2, dtype=np.int64)
        return _finite(Table(path, rows, dict(zip(columns, values, strict=True))))

    def labels(self, path: Path, column: str) -> list[str]:
        header = self.header(path)
        place = _place(column, header, path)
        lines = _lines(path)
        reader = csv.reader(lines, delimiter=_delimiter(next(lines, "")))
        return [line[place].strip() if place < len(line) else "" for line in reader if line]

    def _line_by_line(self, path: Path, columns: Sequence[str], header: Sequence[str], places: Sequence[int]) -> Table:
        lines = _lines(path)
        reader = csv.reader(lines, delimiter=_delimiter(next(lines, "")))
        numbers, values = array("q"), [array("d") for _ in columns]
        uneven: tuple[int, int] | None = None
        refused: dict[int, tuple[int, str]] = {}
        counts = [0] * len(columns)
        for line in reader:
            if not line:
                continue
            numbers.append(reader.line_num + 1)
            if len(line) != len(header):
                uneven = uneven or (numbers[-1], len(line))
            for i, place in enumerate(() if uneven else places):
                try:
                    values[i].append(float(line[place]))
                except ValueError:
                    values[i].append(math.nan)
                    refused.setdefault(i, (numbers[-1], line[place]))
                    counts[i] += 1
        _expect_rows(len(numbers), path)
        if uneven:
            row, width = uneven
            first_missing = f", so {header[width]!r} is missing" if width < len(header) else ""
            raise InvalidData(
                f"{path.name}, row {row}: expected {len(header)} values as the header has, got {width}{first_missing}"
            )
        if refused:
            first = min(refused)
            row, text = refused[first]
            raise InvalidData(
                f"{path.name}, row {row}, column {columns[first]!r}: expected a number, got {text!r}"
                f"{such_rows(counts[first])}. {_mended(text)}"
            )
        read = {name: np.frombuffer(column) for name, column in zip(columns, values, strict=True)}
        return _finite(Table(path, np.frombuffer(numbers, dtype=np.int64), read))


@register_reader("parquet")
class ParquetReader(Reader):
    """A Parquet file; rows are numbered from 1."""

    suffixes = (".parquet", ".pq")

    def header(self, path: Path) -> tuple[str, ...]:
        import pyarrow as pa
        import pyarrow.parquet as pq

        try:
            return tuple(pq.read_schema(path).names)
        except pa.ArrowException as error:
            raise InvalidData(f"{path.name}: not a readable Parquet file: {error}") from error

    def read(self, path: Path, columns: Sequence[str]) -> Table:
        import pyarrow as pa
        import pyarrow.parquet as pq

        header = self.header(path)
        for name in columns:
            _place(name, header, path)
        table = pq.read_table(path, columns=list(columns))
        _expect_rows(table.num_rows, path)
        data = {}
        for name in columns:
            kind = table.schema.field(name).type
            if not (pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind)):
                raise InvalidData(f"{path.name}, column {name!r}: expected numbers, got {kind}. {WORDS}")
            data[name] = np.asarray(table[name].to_numpy(zero_copy_only=False), dtype=np.float64)
        return _finite(Table(path, np.arange(1, table.num_rows + 1), data))

    def labels(self, path: Path, column: str) -> list[str]:
        import pyarrow.parquet as pq

        _place(column, self.header(path), path)
        values = pq.read_table(path, columns=[column])[column].to_pylist()
        return ["" if value is None else f"{value:g}" if isinstance(value, float) else str(value) for value in values]


def reader_for(path: Path) -> Reader:
    """Return the reader of this file's suffix. Raises `InvalidData` if there is none."""
    known = []
    for _, make in readers.load_all():
        reader = make()
        known += reader.suffixes
        if path.suffix.lower() in reader.suffixes:
            return reader
    raise InvalidData(f"{path.name}: expected a file of one of the kinds {', '.join(sorted(known))}")


def such_rows(count: int) -> str:
    """Return in how many rows the same is wrong, in brackets; nothing if it is the one that was named."""
    return f" ({count} such rows)" if count > 1 else ""


def log_suffixes() -> tuple[str, ...]:
    """Return the suffixes of all files that can be read."""
    return tuple(suffix for _, make in readers.load_all() for suffix in make().suffixes)


def _first_line(path: Path) -> str:
    try:
        with path.open(encoding="utf-8-sig") as file:
            return file.readline().rstrip("\n")
    except UnicodeDecodeError as error:
        raise _no_text(path, error) from error


def _lines(path: Path) -> Iterator[str]:
    """Yield the lines of a text, as `str.splitlines` gives them, without having all of it in memory."""
    try:
        with path.open(encoding="utf-8-sig") as file:
            for line in file:
                yield from line.splitlines()
    except UnicodeDecodeError as error:
        raise _no_text(path, error) from error


def _no_text(path: Path, error: UnicodeDecodeError) -> InvalidData:
    """Return what is wrong with a text; its ``error`` counts from the part that was read last, so the row is told."""
    bad = error.object[error.start]
    row = 0
    with path.open("rb") as file, suppress(UnicodeDecodeError):
        for line in file:
            row += 1
            line.decode()
    return InvalidData(f"{path.name}: expected text (UTF-8), got the byte {bad:#04x} in row {row}")


def _parsed(path: Path, delimiter: str, width: int, places: Sequence[int]) -> list[Array] | None:
    """Return the columns at ``places`` of a file of numbers without blank lines, at least two rows; else None."""
    import pyarrow as pa
    from pyarrow import csv as arrow

    names = [str(place) for place in range(width)]
    try:
        table = arrow.read_csv(
            path,
            read_options=arrow.ReadOptions(column_names=names, skip_rows=1),
            parse_options=arrow.ParseOptions(delimiter=delimiter, ignore_empty_lines=False),
            convert_options=arrow.ConvertOptions(
                column_types={names[place]: pa.float64() for place in places},
                include_columns=[names[place] for place in dict.fromkeys(places)],
                null_values=[],
            ),
        )
    except pa.ArrowInvalid:
        return None
    if table.num_rows < 2 or not places:
        return None
    values = [table[names[place]].to_numpy() for place in places]
    del table
    pa.default_memory_pool().release_unused()
    return values


def _delimiter(line: str) -> str:
    return max(",;\t", key=line.count)


def _place(name: str, header: Sequence[str], path: Path) -> int:
    found = [i for i, column in enumerate(header) if column == name]
    if len(found) == 1:
        return found[0]
    if found:
        raise InvalidData(f"{path.name}, row 1: the header names the column {name!r} {len(found)} times")
    lower = {column.lower(): column for column in header}
    close = closest(name.lower(), lower)
    hint = f" Did you mean {lower[close]!r}?" if close else ""
    raise InvalidData(f"{path.name}, row 1: column {name!r} is missing.{hint} The header has: {', '.join(header)}.")


def _mended(text: str) -> str:
    """Return what to do about an entry that is no number: nothing stands there, a comma for the point, or a word."""
    if not text.strip():
        return LEAVE_OUT
    try:
        float(text.replace(",", ".", 1))
    except ValueError:
        return WORDS
    return "Write numbers with a point, not a comma."


def _expect_rows(count: int, path: Path) -> None:
    if count < 2:
        raise InvalidData(f"{path.name}: expected at least two rows of data, got {count}")


def _finite(table: Table) -> Table:
    for name, values in table.columns.items():
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad):
            raise InvalidData(
                f"{table.where(name, int(bad[0]))}: expected a finite number, got {values[bad[0]]}"
                f"{such_rows(len(bad))}. {LEAVE_OUT}"
            )
    return table
