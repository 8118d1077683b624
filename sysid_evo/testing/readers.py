"""The contract of a reader of log files."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sysid_evo.data.readers import Reader, Table
from sysid_evo.errors import InvalidArgument, InvalidData
from sysid_evo.registry.registry import readers
from sysid_evo.testing.contract import Contract, expect, expect_error, expect_numbers, same

NO_COLUMN = "a column that no file has"


@dataclass(frozen=True)
class ReaderExample:
    """A reader called ``name``, and a file of its kind with its original ``content``."""

    name: str
    reader: Reader
    path: Path
    content: bytes

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns of the file that hold numbers."""
        found = []
        for column in self.reader.header(self.path):
            try:
                self.reader.read(self.path, [column])
            except InvalidData:
                continue
            found.append(column)
        return tuple(found)

    def whole(self) -> Table:
        """Return all columns that hold numbers."""
        return self.reader.read(self.path, self.columns)


def check_reader(name: str, path: Path, **parameters: Any) -> None:
    """Raise `ContractViolation` with all rules that the registered reader ``name`` breaks.

    ``path`` is a file of its kind with at least two rows and one column of finite numbers.
    """
    READER.check(name, path, **parameters)


def _reader(name: str, path: Path, **parameters: Any) -> tuple[ReaderExample]:
    if not path.is_file():
        raise InvalidArgument(f"reader {name!r}: expected a file of its kind at {path}, found none")
    return (ReaderExample(name, readers.make(name, **parameters), path, path.read_bytes()),)


def it_names_its_suffixes(example: ReaderExample) -> None:
    """It lists the suffixes of its files, in lower case and with the point; the example has one of them"""
    suffixes = example.reader.suffixes
    sound = isinstance(suffixes, tuple) and suffixes and all(s.startswith(".") and s == s.lower() for s in suffixes)
    expect(sound, f"expected suffixes such as ('.log',), got {suffixes!r}")
    expect(example.path.suffix.lower() in suffixes, f"{example.path.name} has none of {', '.join(suffixes)}")


def no_other_reader_has_its_suffixes(example: ReaderExample) -> None:
    """No other reader has one of its suffixes"""
    for other, make in readers.load_all():
        shared = sorted(set(example.reader.suffixes) & set(make().suffixes)) if other != example.name else []
        expect(not shared, f"reader {other!r} also has {' and '.join(shared)}")


def the_header_names_the_columns(example: ReaderExample) -> None:
    """header returns the names of the columns, each once"""
    header = example.reader.header(example.path)
    expect(
        isinstance(header, tuple) and header and all(isinstance(name, str) and name for name in header),
        f"expected a tuple of names, got {header!r}",
    )
    expect(len(set(header)) == len(header), f"a name occurs twice: {', '.join(header)}")
    expect(example.reader.header(example.path) == header, "a second call returns another header")


def read_gives_finite_numbers(example: ReaderExample) -> None:
    """read returns the requested columns, in that order, as finite float64 numbers of one length"""
    columns = example.columns
    expect(columns, "no column of the example holds numbers")
    requested = columns[::-1]
    table = example.reader.read(example.path, requested)
    expect(tuple(table.columns) == requested, f"expected {', '.join(requested)}, got {', '.join(table.columns)}")
    expect(len(table) >= 2, f"expected at least two rows, got {len(table)}")
    for name, values in table.columns.items():
        expect_numbers(f"column {name!r}", values, (len(table),))


def rows_are_numbered(example: ReaderExample) -> None:
    """Every row has its row number in the file, in increasing order"""
    table = example.whole()
    rows = np.asarray(table.rows)
    expect(rows.dtype.kind == "i" and rows.min() >= 0, f"expected whole numbers from 0 on, got {rows[:3]}")
    expect((np.diff(rows) > 0).all(), "the row numbers do not increase")
    expect(table.path == example.path, f"the path of the table is {table.path}")


def a_column_does_not_depend_on_the_others(example: ReaderExample) -> None:
    """A column does not depend on the other columns that are read with it"""
    whole = example.whole()
    for name in example.columns:
        alone = example.reader.read(example.path, [name])
        expect(same(alone.columns[name], whole.columns[name]), f"column {name!r} alone differs")


def a_missing_column_is_named(example: ReaderExample) -> None:
    """For a missing column it raises InvalidData with the names of the file and the column"""
    error = expect_error(InvalidData, "a missing column", example.reader.read, example.path, [NO_COLUMN])
    for word in (example.path.name, NO_COLUMN):
        expect(word in str(error), f"expected {word!r} in: {error}")


def a_damaged_file_is_refused(example: ReaderExample) -> None:
    """For an empty file or other bytes it raises InvalidData with the name of the file"""
    for name, content in (("empty", b""), ("garbage", np.random.default_rng(0).bytes(400))):
        expect(
            _read_copy(example, name, content) is None,
            f"{name}{example.path.suffix}: expected InvalidData, got no error",
        )


def a_wrong_number_is_refused(example: ReaderExample) -> None:
    """For NaN, nothing, infinity or a word instead of a number it raises InvalidData with the name of the file"""
    whole = example.whole().columns
    for name, content in _with_wrong_numbers(example.content):
        table = _read_copy(example, name, content)
        # the number may be in a text column or a comment; then all other numbers are read as before
        unchanged = table is None or all(same(values, table.columns.get(column)) for column, values in whole.items())
        expect(unchanged, f"{name} instead of a number: expected InvalidData, got other numbers or fewer rows")


def a_file_that_is_cut_short_gives_no_wrong_numbers(example: ReaderExample) -> None:
    """For a truncated file it raises InvalidData with the name of the file, or returns the complete rows"""
    whole = example.whole()
    for quarters in (1, 2, 3):
        table = _read_copy(example, "cut", example.content[: quarters * len(example.content) // 4])
        for name, values in () if table is None else table.columns.items():
            expect_numbers(f"column {name!r} of a truncated file", values, values.shape)
            before = values[:-1]  # the last number may be truncated itself
            expect(same(before, whole.columns[name][: len(before)]), f"column {name!r} has other numbers than before")


def the_file_is_left_alone(example: ReaderExample) -> None:
    """Reading does not change the file"""
    example.whole()
    expect(example.path.read_bytes() == example.content, "the file has changed")


CHECKS = (
    it_names_its_suffixes,
    no_other_reader_has_its_suffixes,
    the_header_names_the_columns,
    read_gives_finite_numbers,
    rows_are_numbered,
    a_column_does_not_depend_on_the_others,
    a_missing_column_is_named,
    a_damaged_file_is_refused,
    a_wrong_number_is_refused,
    a_file_that_is_cut_short_gives_no_wrong_numbers,
    the_file_is_left_alone,
)
READER = Contract(readers, _reader, CHECKS)


def _read_copy(example: ReaderExample, name: str, content: bytes) -> Table | None:
    """Return the table of a file with this content, None if the reader raises InvalidData with its name."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{name}{example.path.suffix}"
        path.write_bytes(content)
        try:
            return example.reader.read(path, example.columns)
        except InvalidData as error:
            expect(path.name in str(error), f"expected {path.name!r} in: {error}")
            return None


NUMBER = re.compile(rb"(?<![\w.+-])-?\d+(\.\d+)?([eE][-+]?\d+)?(?![\w.])")
WRONG = {"nan": b"NaN", "nothing": b"", "infinity": b"1e999", "word": b"three"}


def _with_wrong_numbers(content: bytes) -> Iterator[tuple[str, bytes]]:
    """Yield the content of a text file with one number replaced, in the middle or last; nothing for binary files."""
    if b"\0" in content:
        return
    numbers = list(NUMBER.finditer(content))
    for found in {numbers[len(numbers) // 2], numbers[-1]} if numbers else ():
        for name, wrong in WRONG.items():
            yield name, content[: found.start()] + wrong + content[found.end() :]
