"""Readers of files with columns, which return arrays of finite numbers and their rows in the file."""

from __future__ import annotations

import codecs
import csv
import math
import os
from abc import ABC, abstractmethod
from array import array
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from sysid_evo.errors import InvalidData, closest
from sysid_evo.registry.registry import readers, register_reader
from sysid_evo.types import Array, IntArray

if TYPE_CHECKING:
    import pyarrow as pa

LEAVE_OUT = (
    "Leave such rows out before importing (where a file has time stamps it is then split there), or fill them yourself."
)
DROP = (
    'Give missing = "drop" in the column map to leave such rows out, which splits the log there, or fill them '
    "yourself. If a command is logged less often than the rest, give its control hold = true (docs/data.md)."
)
WORDS = "A command in words needs the number of each in the column map: words = {stop = 0.0, go = 1.0} (docs/data.md)."


@dataclass(frozen=True)
class Table:
    """N rows of named columns (N,); ``rows`` (N,) are their numbers in the file ``path``.

    ``texts`` are columns of text, by name.
    """

    path: Path
    rows: IntArray
    columns: Mapping[str, Array]
    texts: Mapping[str, Sequence[str]] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.rows)

    def where(self, column: str, row: int) -> str:
        """Return file, row and column of an entry as text; ``row`` counts from 0 in this table."""
        return f"{self.path.name}, row {self.rows[row]}, column {column!r}"


MISSING = ("", "nan", "NaN", "NA", "N/A", "null", "NULL", "None")
"""Texts for a missing value: empty, and those of NumPy, pandas, R, SQL and Python."""


class Reader(ABC):
    """Reads one kind of file, recognised by its suffix.

    ``encoding`` is that of a text file (None: UTF-8, or UTF-16 and UTF-32 with a byte order mark). With ``gaps`` a
    missing value is read as NaN; without, it is an error.
    """

    suffixes: ClassVar[tuple[str, ...]]
    encoding: str | None = None
    gaps: bool = False

    @abstractmethod
    def header(self, path: Path) -> tuple[str, ...]:
        """Return the names of the columns."""

    @abstractmethod
    def read(self, path: Path, columns: Sequence[str]) -> Table:
        """Return the table of ``columns``. Raises `InvalidData` with file, row and column."""

    def texts(self, path: Path, column: str) -> list[str]:
        """Return the texts of a column for the rows that `read` returns; by default its numbers as text."""
        return [f"{value:g}" for value in self.read(path, [column]).columns[column]]


@register_reader("csv")
class CsvReader(Reader):
    """Text with one header line; separated by comma, semicolon or tab.

    Rows are numbered as in an editor: the header is row 1. Files are parsed by pyarrow; a file that it
    refuses is read line by line, to report the row and the error.
    """

    suffixes = (".csv", ".txt", ".tsv")

    def header(self, path: Path) -> tuple[str, ...]:
        line = self._first_line(path)
        names = tuple(name.strip() for name in next(csv.reader([line], delimiter=_delimiter(line)), []))
        if not any(names):
            raise InvalidData(f"{path.name}: expected a header line with the names of the columns, the file is empty")
        return names

    def read(self, path: Path, columns: Sequence[str]) -> Table:
        header = self.header(path)
        places = [_place(name, header, path) for name in columns]
        values = self._parsed(path, len(header), places)
        if values is None:
            return self._line_by_line(path, columns, header, places)
        rows = np.arange(2, len(values[0]) + 2, dtype=np.int64)
        return _finite(Table(path, rows, dict(zip(columns, values, strict=True))), self.gaps)

    def texts(self, path: Path, column: str) -> list[str]:
        header = self.header(path)
        place = _place(column, header, path)
        lines = self._lines(path)
        reader = csv.reader(lines, delimiter=_delimiter(next(lines, "")))
        return [line[place].strip() if place < len(line) else "" for line in reader if line]

    def _line_by_line(self, path: Path, columns: Sequence[str], header: Sequence[str], places: Sequence[int]) -> Table:
        lines = self._lines(path)
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
                    if self.gaps and line[place].strip() in MISSING:
                        continue
                    refused.setdefault(i, (numbers[-1], line[place]))
                    counts[i] += 1
        _expect_rows(len(numbers), path)
        if uneven:
            row, width = uneven
            first_missing = f", so {header[width]!r} is missing" if width < len(header) else ""
            raise InvalidData(
                f"{path.name}, row {row}: expected {len(header)} values as in the header, got {width}{first_missing}"
            )
        if refused:
            first = min(refused)
            row, text = refused[first]
            raise InvalidData(
                f"{path.name}, row {row}, column {columns[first]!r}: expected a number, got {text!r}"
                f"{such_rows(counts[first])}. {_remedy(text)}"
            )
        read = {name: np.frombuffer(column) for name, column in zip(columns, values, strict=True)}
        return _finite(Table(path, np.frombuffer(numbers, dtype=np.int64), read), self.gaps)

    def _parsed(self, path: Path, width: int, places: Sequence[int]) -> list[Array] | None:
        """Return the columns at ``places`` of a file of numbers without blank lines, at least two rows; else None."""
        import pyarrow as pa
        from pyarrow import csv as arrow

        names = [str(place) for place in range(width)]
        encoding = self._encoding(path)
        try:
            table = arrow.read_csv(
                path,
                read_options=arrow.ReadOptions(
                    column_names=names, skip_rows=1, encoding="utf8" if encoding == "utf-8-sig" else encoding
                ),
                parse_options=arrow.ParseOptions(
                    delimiter=_delimiter(self._first_line(path)), ignore_empty_lines=False
                ),
                convert_options=arrow.ConvertOptions(
                    column_types={names[place]: pa.float64() for place in places},
                    include_columns=[names[place] for place in dict.fromkeys(places)],
                    null_values=list(MISSING) if self.gaps else [],
                ),
            )
        except (pa.ArrowInvalid, UnicodeError):
            return None
        if table.num_rows < 2 or not places:
            return None
        values = [table[names[place]].to_numpy() for place in places]
        del table
        pa.default_memory_pool().release_unused()
        blank = self.gaps and np.all([np.isnan(column) for column in values], axis=0).any()  # a row for pyarrow
        return None if blank else values

    def _encoding(self, path: Path) -> str:
        """Return the encoding of a text: the given one, else that of its byte order mark, else UTF-8."""
        with path.open("rb") as file:
            start = file.read(4)
        if self.encoding is not None:
            return self.encoding
        if start in (codecs.BOM_UTF32_LE, codecs.BOM_UTF32_BE):
            return "utf-32"
        return "utf-16" if start[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE) else "utf-8-sig"

    def _first_line(self, path: Path) -> str:
        line = next(self._lines(path), "").removeprefix("\ufeff")
        if "\0" in line:
            raise InvalidData(
                f"{path.name}: expected text, got bytes of 0 in row 1. If it is UTF-16 without a byte order mark, "
                'give encoding = "utf-16-le" in the column map'
            )
        return line

    def _lines(self, path: Path) -> Iterator[str]:
        """Yield the lines of a text, as in `str.splitlines`, without reading the whole file into memory."""
        encoding = self._encoding(path)
        try:
            with path.open(encoding=encoding) as file:
                for line in file:
                    yield from line.splitlines()
        except UnicodeError as error:
            raise _no_text(path, encoding, error) from error


@register_reader("parquet")
class ParquetReader(Reader):
    """A Parquet file; rows are numbered from 1."""

    suffixes = (".parquet", ".pq")

    def header(self, path: Path) -> tuple[str, ...]:
        import pyarrow.parquet as pq

        with _named(path):
            return tuple(pq.read_schema(path).names)

    def read(self, path: Path, columns: Sequence[str]) -> Table:
        import pyarrow as pa

        header = self.header(path)
        for name in columns:
            _place(name, header, path)
        table = read_parquet(path, columns)
        _expect_rows(table.num_rows, path)
        data = {}
        for name in columns:
            kind = table.schema.field(name).type
            if not (pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind)):
                raise InvalidData(f"{path.name}, column {name!r}: expected numbers, got {kind}. {WORDS}")
            data[name] = np.asarray(table[name].to_numpy(zero_copy_only=False), dtype=np.float64)
        return _finite(Table(path, np.arange(1, table.num_rows + 1), data), self.gaps)

    def texts(self, path: Path, column: str) -> list[str]:
        _place(column, self.header(path), path)
        values = read_parquet(path, [column])[column].to_pylist()
        return ["" if value is None else f"{value:g}" if isinstance(value, float) else str(value) for value in values]


MOST_ROWS = 20_000_000
"""Largest number of rows of a Parquet file that are read by default: 28 hours at 200 Hz.

A file of a few bytes can declare any number of rows. A million rows of nine columns take 0.4 GB (docs/data.md, "Long
recordings"), this number takes 8 GB.
"""
VARIABLE = "SYSID_EVO_MOST_ROWS"


def read_parquet(path: Path, columns: Sequence[str]) -> pa.Table:
    """Return ``columns`` of a Parquet file. Raises `InvalidData`, for too many rows before anything is read."""
    import pyarrow.parquet as pq

    given = os.environ.get(VARIABLE, "")
    if given and not given.isdecimal():
        raise InvalidData(f"{VARIABLE}: expected the largest number of rows of a Parquet file, got {given!r}")
    most = int(given or MOST_ROWS)
    with _named(path):
        about = pq.read_metadata(path)
        # the reader uses the counts of the groups; the sum at the end of the file may differ
        rows = max(about.num_rows, sum(about.row_group(group).num_rows for group in range(about.num_row_groups)))
        if rows > most:
            raise InvalidData(
                f"{path.name}: declares {rows} rows, more than the {most} that are read. If that is right and there is "
                f"enough memory, about 16 bytes for each row and column, set {VARIABLE}={rows}"
            )
        return pq.read_table(path, columns=list(columns))


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Convert errors of pyarrow on a damaged Parquet file to `InvalidData` with the name of the file."""
    import pyarrow as pa

    try:
        yield
    except (pa.ArrowException, OSError) as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise  # an error of the operating system, which names the file; those of pyarrow have no number
        raise InvalidData(f"{path.name}: not a readable Parquet file: {error}") from error


def find_reader(path: Path, *, encoding: str | None = None, gaps: bool = False) -> Reader:
    """Return the reader of this file's suffix, see `Reader`. Raises `InvalidData` if there is none."""
    known = []
    for _, make in readers.load_all():
        reader = make()
        known += reader.suffixes
        if path.suffix.lower() in reader.suffixes:
            reader.encoding, reader.gaps = encoding, gaps
            return reader
    raise InvalidData(f"{path.name}: expected a file of one of the kinds {', '.join(sorted(known))}")


def such_rows(count: int) -> str:
    """Return the number of rows with the same error, in brackets; empty for a single one."""
    return f" ({count} such rows)" if count > 1 else ""


def log_suffixes() -> tuple[str, ...]:
    """Return the suffixes of all files that can be read."""
    return tuple(suffix for _, make in readers.load_all() for suffix in make().suffixes)


def _no_text(path: Path, encoding: str, error: UnicodeError) -> InvalidData:
    """Return the error for a text that cannot be decoded, with its row; ``error`` counts from the last part read."""
    found = ""
    if isinstance(error, UnicodeDecodeError):
        row = 0
        with path.open("rb") as file, suppress(UnicodeError):
            for line in file:  # wrong for UTF-16, for which no row is reported
                row += 1
                line.decode(encoding)
        found = f", got the byte {error.object[error.start]:#04x} in row {row}"
    kind = "UTF-8" if encoding == "utf-8-sig" else encoding
    return InvalidData(
        f"{path.name}: expected text ({kind}){found}. Name its encoding in the column map (docs/data.md), "
        'encoding = "cp1252" for ANSI or Latin-1 of Windows and Excel, or save the file as UTF-8'
    )


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
    hint = f" Did you mean {lower[close]!r}?" if close else " Every log needs all columns of the map."
    raise InvalidData(f"{path.name}, row 1: column {name!r} is missing.{hint} The header has: {', '.join(header)}.")


def _remedy(text: str) -> str:
    """Return the remedy for an entry that is not a number: it is empty, has a decimal comma, or is a word."""
    if text.strip() in MISSING:
        return DROP
    try:
        float(text.replace(",", ".", 1))
    except ValueError:
        return WORDS
    return "Write numbers with a point, not a comma."


def _expect_rows(count: int, path: Path) -> None:
    if count < 2:
        raise InvalidData(f"{path.name}: expected at least two rows of data, got {count}")


def _finite(table: Table, gaps: bool) -> Table:
    """Return ``table``. Raises `InvalidData` if a number is infinite or, without ``gaps``, missing."""
    for name, values in table.columns.items():
        bad = np.flatnonzero(np.isinf(values) if gaps else ~np.isfinite(values))
        if len(bad):
            raise InvalidData(
                f"{table.where(name, int(bad[0]))}: expected a finite number, got {values[bad[0]]}"
                f"{such_rows(len(bad))}. {DROP if np.isnan(values[bad[0]]) else LEAVE_OUT}"
            )
    return table
