"""The journal of the robot's side."""

import pytest

from sysid_evo.errors import InvalidData
from tests.system.rig.journal import Entry, JournalReader, JournalWriter, buttons_at, opened_after, read_journal

PRESSES = [Entry(1.0, "buttons", 1), Entry(2.0, "buttons", 5), Entry(3.0, "buttons", 0), Entry(3.5, "out", "00")]


def test_entries_come_back_in_order(tmp_path):
    writer = JournalWriter(tmp_path / "journal")
    for entry in PRESSES:
        writer.note(entry.time, entry.event, entry.value)
    assert read_journal(tmp_path / "journal") == PRESSES
    writer.close()


def test_a_line_that_is_being_written_is_left_out(tmp_path):
    path = tmp_path / "journal"
    path.write_text('{"time": 1.0, "event": "plug", "value": null}\n{"time": 2.')
    assert [entry.time for entry in read_journal(path)] == [1.0]


def test_a_reader_follows_a_journal(tmp_path):
    writer, reader = JournalWriter(tmp_path / "journal"), JournalReader(tmp_path / "journal")
    for count, entry in enumerate(PRESSES):
        assert reader.update() == PRESSES[:count]
        writer.note(entry.time, entry.event, entry.value)
    assert reader.update() == reader.update() == PRESSES
    writer.close()


def test_another_file_is_refused(tmp_path):
    path = tmp_path / "journal"
    path.write_text("hello\n")
    with pytest.raises(InvalidData, match="expected JSON lines"):
        read_journal(path)


def test_buttons_are_found_for_any_time():
    assert [buttons_at(PRESSES, time) for time in (0.5, 1.0, 2.5, 9.0)] == [0, 1, 5, 0]


def test_buttons_that_open_for_good_are_found():
    assert opened_after(PRESSES, 0.5) == 3.0
    assert opened_after(PRESSES, 2.5) == 3.0
    assert opened_after(PRESSES, 4.0) == 4.0
    assert opened_after([*PRESSES, Entry(5.0, "buttons", 2)], 4.0) is None
    assert opened_after(PRESSES[:2], 1.5) is None
