"""The commands import, inspect and record, as a user types them."""

from __future__ import annotations

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from sysid_evo.cli.app import app
from sysid_evo.data import Dataset
from sysid_evo.errors import InvalidData


def run(*arguments):
    """Run a command; return its results (standard output) and its remarks (standard error)."""
    result = CliRunner().invoke(app, [str(argument) for argument in arguments], terminal_width=80)
    if result.exception is not None:
        raise result.exception
    return result.stdout, result.stderr


def test_import_stores_what_read_returns_and_tells_the_notes(write_csv, table, columns_file, tmp_path):
    path, columns = write_csv(table), columns_file((", low = -1.0, high = 1.0", ""))
    results, remarks = run("import", path, "--columns", columns, "--out", tmp_path / "data")
    stored = Dataset.load(tmp_path / "data")
    assert stored.fingerprint == Dataset.read(path, columns=columns).fingerprint
    assert "log" in results
    assert "data set stored in" in results
    assert "note: control 'drive' has no limits" in remarks
    assert "note" not in results


def test_import_takes_the_conditions_from_a_column(write_csv, table, columns_file, tmp_path):
    path = write_csv({**table, "battery": np.repeat([1.0, 2.0], [100, 101])})
    run("import", path, "--columns", columns_file(), "--condition-column", "battery", "--out", tmp_path / "data")
    assert Dataset.load(tmp_path / "data").conditions == ("1.0", "2.0")


def test_import_warns_of_what_looks_wrong(write_csv, table, columns_file, tmp_path):
    table["throttle"][:] = 0.25
    _, remarks = run("import", write_csv(table), "--columns", columns_file(), "--out", tmp_path / "data")
    assert "warning: log.csv, every row, column 'throttle': control 'drive' is constant" in remarks.replace("\n", " ")


def test_import_leaves_nothing_behind_when_a_log_is_bad(write_csv, table, columns_file, tmp_path):
    table["u"][3] = np.nan
    with pytest.raises(InvalidData, match=r"log\.csv, row 5, column 'u'"):
        run("import", write_csv(table), "--columns", columns_file(), "--out", tmp_path / "data")
    assert not (tmp_path / "data").exists()


def test_inspect_shows_tables_of_at_most_80_columns(write_csv, table, columns_file):
    path = write_csv(table, "a_recording_with_a_rather_long_name_of_forty.csv")
    results, _ = run("inspect", path, "--columns", columns_file())
    assert max(len(line.rstrip()) for line in results.splitlines()) <= 80
    for heading in ("Excitation", "States", "Coverage", "Delay of a control", "Time between rows", "Suggestions"):
        assert heading in results


def test_inspect_prints_json_that_a_program_can_read(write_csv, table, columns_file, tmp_path):
    columns = columns_file()
    run("import", write_csv(table), "--columns", columns, "--out", tmp_path / "data")
    results, _ = run("inspect", tmp_path / "data", "--json")
    advice = json.loads(results)
    assert advice["fingerprint"] == Dataset.load(tmp_path / "data").fingerprint
    assert advice["episodes"] == [{"name": "log", "steps": 200}]
    assert [state["name"] for state in advice["states"]] == ["forward_speed", "yaw_rate"]
    assert advice["sampling"] == []


def test_recording_an_emulated_car_stores_a_data_set_that_its_raw_logs_give_again(tmp_path):
    results, remarks = run("record", "--out", tmp_path / "drive", "--seed", 3, "--minutes", 0.5)
    assert "data set stored in" in results
    assert "without delay" in remarks
    stored = Dataset.load(tmp_path / "drive")
    again = Dataset.read(tmp_path / "drive" / "raw")
    assert sorted(again.names) == sorted(stored.names)
    by_name = {episode.name: episode for episode in again}
    for episode in stored:
        np.testing.assert_allclose(by_name[episode.name].states, episode.states, atol=1e-5)
        np.testing.assert_array_equal(by_name[episode.name].controls, episode.controls)


def test_a_log_without_controls_or_motion_is_imported_and_inspected(write_csv, tmp_path, rng):
    columns = tmp_path / "free.toml"
    columns.write_text('name = "leaking tank"\ndt = 1.0\n[states]\nlevel = { column = "h", unit = "m", low = 0.5 }\n')
    level = 0.5 + 2.0 * np.exp(-np.arange(400.0) / 60.0)
    path = write_csv({"h": level})
    run("import", path, "--columns", columns, "--out", tmp_path / "data")
    results, _ = run("inspect", tmp_path / "data")
    assert "in motion" not in results
    assert "leaking tank: 1 episode, 399 s at 1 Hz" in results
    assert Dataset.load(tmp_path / "data").system.states[0].neutral == 0.5
