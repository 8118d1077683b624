"""Readers: the same numbers from every kind of file."""

import re
import tracemalloc
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from sysid_evo.data import Dataset, Reader, Table
from sysid_evo.data.readers import CsvReader, ParquetReader, find_reader
from sysid_evo.data.reading import log_files
from sysid_evo.errors import InvalidArgument, InvalidData
from sysid_evo.registry.registry import readers


def test_both_readers_are_registered_under_their_entry_points():
    assert {"csv", "parquet"} <= set(readers.names())
    assert readers.get("csv") is CsvReader
    assert readers.get("parquet") is ParquetReader


def test_csv_and_parquet_give_the_same_data_set(write_csv, table, columns_file, tmp_path):
    path = tmp_path / "log.parquet"
    pq.write_table(pa.table(table), path)
    columns = columns_file()
    by_csv, by_parquet = Dataset.read(write_csv(table), columns=columns), Dataset.read(path, columns=columns)
    assert by_csv.fingerprint == by_parquet.fingerprint


@pytest.mark.parametrize("separator", [";", "\t"])
def test_other_separators_a_byte_order_mark_and_blank_lines_change_nothing(write_csv, table, separator):
    plain = CsvReader().read(write_csv(table), ["t", "r"])
    path = write_csv(table, "other.csv", separator)
    head, _, body = path.read_text().partition("\n")
    path.write_text("\ufeff" + head.replace(separator, f" {separator} ") + "\n\n" + body)
    other = CsvReader().read(path, ["t", "r"])
    np.testing.assert_array_equal(other.columns["r"], plain.columns["r"])
    assert other.rows[0] == plain.rows[0] + 1


def test_a_bad_parquet_cell_is_named_by_its_row(tmp_path):
    path = tmp_path / "log.parquet"
    pq.write_table(pa.table({"t": [0.0, 1.0, 2.0], "n": [1, None, 3], "s": ["a", "b", "c"]}), path)
    with pytest.raises(InvalidData, match=r"log\.parquet, row 2, column 'n': expected a finite number, got nan"):
        ParquetReader().read(path, ["t", "n"])
    with pytest.raises(InvalidData, match=r"log.parquet, column 's': expected numbers, got string"):
        ParquetReader().read(path, ["s"])


def test_a_file_that_is_not_what_its_suffix_says(tmp_path):
    (tmp_path / "log.parquet").write_text("t,x\n")
    with pytest.raises(InvalidData, match=r"log.parquet: not a readable Parquet file"):
        ParquetReader().header(tmp_path / "log.parquet")
    (tmp_path / "log.csv").write_bytes(b"\xff\x80")
    with pytest.raises(InvalidData, match=r"log.csv: expected text"):
        CsvReader().header(tmp_path / "log.csv")


def test_a_parquet_file_that_declares_too_many_rows_is_refused_before_it_is_read(tmp_path, monkeypatch):
    path = tmp_path / "log.parquet"
    pq.write_table(pa.table({"t": np.zeros(25_000_000, np.int8)}), path)
    assert path.stat().st_size < 100_000
    used = pa.default_memory_pool().max_memory()
    for read in (ParquetReader().read, lambda path, names: ParquetReader().texts(path, *names)):
        with pytest.raises(InvalidData, match=r"log.parquet: declares 25000000 rows, more than the 20000000 that are"):
            read(path, ["t"])
    assert pa.default_memory_pool().max_memory() == used
    few = tmp_path / "few.parquet"
    pq.write_table(pa.table({"t": np.zeros(3, np.int8)}), few)
    monkeypatch.setenv("SYSID_EVO_MOST_ROWS", "3")
    assert len(ParquetReader().read(few, ["t"])) == 3
    monkeypatch.setenv("SYSID_EVO_MOST_ROWS", "2")
    with pytest.raises(InvalidData, match="declares 3 rows, more than the 2 that are"):
        ParquetReader().read(few, ["t"])
    group = SimpleNamespace(num_rows=3)  # the end of a file may declare fewer rows than its groups have
    forged = SimpleNamespace(num_rows=1, num_row_groups=2, row_group=lambda _: group)
    monkeypatch.setattr(pq, "read_metadata", lambda _: forged)
    with pytest.raises(InvalidData, match="declares 6 rows"):
        ParquetReader().read(few, ["t"])
    monkeypatch.setenv("SYSID_EVO_MOST_ROWS", "many")
    with pytest.raises(InvalidData, match=r"SYSID_EVO_MOST_ROWS: expected the largest number of rows .*, got 'many'"):
        ParquetReader().read(path, ["t"])


def test_a_parquet_file_with_damaged_pages_is_named(tmp_path, rng):
    path = tmp_path / "log.parquet"
    pq.write_table(pa.table({"t": rng.normal(size=1000).round(1)}), path, compression="snappy")
    content = bytearray(path.read_bytes())
    content[40:400] = bytes(255 for _ in range(360))
    path.write_bytes(content)
    for read in (lambda: ParquetReader().read(path, ["t"]), lambda: ParquetReader().texts(path, "t")):
        with pytest.raises(InvalidData, match=r"log.parquet: not a readable Parquet file: "):
            read()


def test_utf_16_is_known_by_its_mark_and_other_encodings_by_the_column_map(write_csv, table, columns_file):
    plain = Dataset.read(write_csv(table), columns=columns_file()).fingerprint
    text = write_csv(table).read_text().replace("throttle", "Gaspedal ä")
    german = ('column = "throttle"', 'column = "Gaspedal ä"')
    path = write_csv(table)
    for encoding in ("utf-16", "utf-32", "utf-8-sig"):
        path.write_bytes(text.encode(encoding))
        assert Dataset.read(path, columns=columns_file(german)).fingerprint == plain
    for encoding in ("cp1252", "utf-16-le"):
        path.write_bytes(text.encode(encoding))
        with pytest.raises(InvalidData, match=r'log.csv: expected text.*encoding = "(cp1252|utf-16-le)"'):
            Dataset.read(path, columns=columns_file(german))
        named = columns_file(german, ("dt = 0.05", f'dt = 0.05\nencoding = "{encoding}"'))
        assert Dataset.read(path, columns=named).fingerprint == plain
        slow = text.replace("\n", "\n\n", 1)  # a blank line, so that it is read line by line
        path.write_bytes(slow.encode(encoding))
        assert Dataset.read(path, columns=named).fingerprint == plain
    with pytest.raises(InvalidData, match="encoding: no text encoding 'latin-l'"):
        Dataset.read(path, columns=columns_file(("dt = 0.05", 'dt = 0.05\nencoding = "latin-l"')))


def test_a_column_map_may_have_a_byte_order_mark_and_must_be_utf_8(write_csv, table, columns_file):
    columns = columns_file()
    text = columns.read_text()
    columns.write_bytes(text.encode("utf-8-sig"))
    assert len(Dataset.read(write_csv(table), columns=columns)) == 1
    columns.write_bytes(text.replace("test car", "Wägelchen").encode("cp1252"))
    with pytest.raises(InvalidData, match=r"car.toml: expected a TOML file, which is UTF-8"):
        Dataset.read(write_csv(table), columns=columns)


def test_a_column_named_twice(tmp_path):
    (tmp_path / "log.csv").write_text("t,x,x\n0,1,2\n1,2,3\n")
    with pytest.raises(InvalidData, match="row 1: the header names the column 'x' 2 times"):
        CsvReader().read(tmp_path / "log.csv", ["x"])


def test_a_plugin_reader_is_found_by_its_suffix(tmp_path):
    class Made(Reader):
        suffixes = (".made",)

        def header(self, path):
            return ("t",)

        def read(self, path, columns):
            return Table(path, np.arange(2), {"t": np.arange(2.0)})

    with pytest.raises(InvalidData, match=r"log.made: expected a file of one of the kinds \.csv, \.parquet"):
        find_reader(tmp_path / "log.made")
    readers.register("made")(Made)
    try:
        assert isinstance(find_reader(tmp_path / "log.made"), Made)
    finally:
        readers.forget("made")


def test_folders_are_searched_for_logs_in_order_and_names_must_differ(write_csv, table, tmp_path):
    for name in ("b.csv", "a.csv", "notes.md"):
        write_csv(table, name)
    assert [file.name for file in log_files(tmp_path)] == ["a.csv", "b.csv"]
    (tmp_path / "more").mkdir()
    write_csv(table, "more/a.csv")
    with pytest.raises(InvalidData, match="several are called a; rename them"):
        log_files([tmp_path, tmp_path / "more"])
    with pytest.raises(InvalidArgument, match="nothing there"):
        log_files(tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InvalidData, match="in this folder, found none"):
        log_files(tmp_path / "empty")


def test_the_fast_and_the_careful_parser_of_csv_read_the_same_bits(tmp_path, rng):
    values = rng.normal(size=(200, 3)) * 10.0 ** rng.integers(-300, 300, (200, 3))
    lines = [",".join(map(repr, row)) for row in values.tolist()]
    fast, careful = tmp_path / "fast.csv", tmp_path / "careful.csv"
    fast.write_text("\n".join(["a,b,c", *lines]) + "\n")
    careful.write_text("\n".join(["a,b,c", "", *lines]) + "\n")
    first, second = (CsvReader().read(path, ["c", "a"]) for path in (fast, careful))
    assert (first.rows[0], first.rows[-1]) == (2, 201)
    assert (second.rows[0], second.rows[-1]) == (3, 202)
    for name, place in (("a", 0), ("c", 2)):
        np.testing.assert_array_equal(first.columns[name], values[:, place])
        np.testing.assert_array_equal(second.columns[name], values[:, place])


def test_a_flawless_csv_is_not_read_line_by_line(tmp_path, monkeypatch):
    path = tmp_path / "log.csv"
    path.write_text('t,x,comment\r\n0, 1.5 ,fine\r\n1,-2e3,"a, b"\r\n')
    monkeypatch.setattr(CsvReader, "_line_by_line", None)
    np.testing.assert_array_equal(CsvReader().read(path, ["x"]).columns["x"], [1.5, -2000.0])


@pytest.mark.parametrize(
    ("bad", "told"),
    [
        (b"3\n", "row 20002: expected 2 values as in the header, got 1, so 'x' is missing"),
        (b"3,four\n", "row 20002, column 'x': expected a number, got 'four'"),
        (b"3,nan\n", "row 20002, column 'x': expected a finite number, got nan"),
        (b"3,\xff\n", "expected text (UTF-8), got the byte 0xff in row 20002"),
    ],
)
def test_a_bad_row_far_down_a_csv_is_named(tmp_path, bad, told):
    path = tmp_path / "log.csv"
    path.write_bytes(b"t,x\n" + b"1,2\n" * 20_000 + bad + b"1,2\n")
    with pytest.raises(InvalidData, match=re.escape(told)):
        CsvReader().read(path, ["t", "x"])


def test_of_several_faults_of_a_csv_the_width_is_reported_first_then_the_first_requested_column(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("t,x\nlate,1\n0,early\n1\n2,3\n")
    with pytest.raises(InvalidData, match="row 4: expected 2 values"):
        CsvReader().read(path, ["x", "t"])
    path.write_text("t,x\nlate,1\n0,early\n2,3\n")
    with pytest.raises(InvalidData, match="row 3, column 'x': expected a number, got 'early'"):
        CsvReader().read(path, ["x", "t"])


def test_a_csv_read_line_by_line_takes_no_more_memory_than_its_numbers(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("t,x,comment\n\n" + "".join(f"{i},{i / 7},a long remark on this row\n" for i in range(20_000)))
    tracemalloc.start()
    try:
        table = CsvReader().read(path, ["t", "x"])
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert len(table) == 20_000
    assert peak < 3 * 20_000 * 3 * 8
