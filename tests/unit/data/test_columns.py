"""Column maps: what they may say, what they do to the numbers, and how one is chosen."""

import math

import numpy as np
import pandas as pd
import pytest

from sysid_evo.data import Dataset, load_columns, read_recording
from sysid_evo.data.columns import choose_columns, shipped_columns, shipped_names
from sysid_evo.data.preparation import PreparedLog, merged_notes
from sysid_evo.data.units import spelled, spelled_range, to_si, units_of
from sysid_evo.errors import InvalidArgument, InvalidData


@pytest.mark.parametrize(
    "change, where, what",
    [
        (('column = "u"', 'colum = "u"'), "states.forward_speed.colum", "unknown key; did you mean 'column'?"),
        (("dt = 0.05", "dt = -1.0"), "dt", "greater than 0"),
        (("dt = 0.05", 'dt = "0.05"'), "dt", "valid number"),
        (('unit = "rad/s"', 'unit = "m/s"'), "map", "states.yaw_rate.unit: expected one of rad/s, deg/s, rpm, got"),
        (('"yaw", unit = "rad"', '"yaw", unit = "m"'), "map", "pose.heading.unit: expected one of rad, mrad, deg"),
        (('forward = "forward_speed"', 'forward = "u"'), "map", "motion.forward names 'u', but the states are"),
        (
            ('column = "u"', 'column = "u", periodic = true'),
            "states.forward_speed",
            "periodic.unit: expected one of rad",
        ),
        (('unit = "rad/s" }', 'unit = "deg", periodic = true, low = 0.0 }'), "states.yaw_rate", "has no limits"),
        ((", high = 1.0", ""), "controls.drive", "both low and high, or neither"),
        (('x = { column = "x", unit = "m" }', ""), "map", "pose: expected x, y, heading, got y, heading"),
        (('column = "t"', 'column = "t"\nunit = "min"'), "time.unit", "'s', 'ms', 'us' or 'ns'"),
        (('column = "u"', 'column = "u", derivative_of = "v"'), "states.forward_speed", "column or derivative_of"),
        (('column = "u"', 'derivative_of = "x"'), "map", "derivative_of: expected a state with a column (yaw_rate)"),
        (('column = "u"', 'derivative_of = "yaw_rate"'), "map", "forward_speed.unit: expected one of rad/s^2, got"),
    ],
)
def test_a_wrong_map_is_refused_with_the_path_of_the_key(columns_file, change, where, what):
    with pytest.raises(InvalidData) as caught:
        load_columns(columns_file(change))
    first, second = str(caught.value).splitlines()[:2]
    assert first.endswith("car.toml: not a column map:")
    assert second.startswith(f"  {where}: ")
    assert what in second


def test_a_file_that_is_not_toml_and_one_that_is_not_there(columns_file, tmp_path):
    with pytest.raises(InvalidData, match=r"car.toml: not a TOML file: .*line 2"):
        load_columns(columns_file(('name = "test car"', "name = test car")))
    with pytest.raises(InvalidArgument, match=r"expected a TOML file or one of dart_20hz, .*; found neither"):
        load_columns(tmp_path / "nowhere.toml")
    with pytest.raises(InvalidArgument, match=r"expected a TOML file or one of dart_20hz, .*; it is a folder"):
        load_columns(tmp_path)


def test_units_and_factors_become_si_units(write_csv, table, columns_file):
    columns = columns_file(
        ('column = "t"', 'column = "t"\nunit = "ms"'),
        ('"u", unit = "m/s"', '"u", unit = "km/h"'),
        ('"x", unit = "m"', '"x", unit = "mm", factor = -1.0'),
        ('"throttle", low', '"throttle", factor = 0.01, low'),
    )
    scaled = {
        **table, "t": 1e3 * table["t"], "u": 3.6 * table["u"], "x": -1e3 * table["x"],
        "throttle": 100.0 * table["throttle"],
    }  # fmt: skip
    (episode,) = Dataset.read(write_csv(scaled), columns=columns)
    np.testing.assert_allclose(episode.states[:, 0], table["u"])
    np.testing.assert_allclose(episode.pose[:, 0], table["x"])
    np.testing.assert_allclose(episode.controls[:, 0], table["throttle"][:-1])


def test_negative_values_are_set_to_zero_before_the_gate_multiplies(write_csv, table, columns_file):
    columns = columns_file(
        ('"throttle", low = -1.0', '"throttle", gate = "armed", non_negative = true, low = 0.0'),
    )
    armed = (np.arange(201) % 3 != 0).astype(float)
    dataset = Dataset.read(write_csv({**table, "armed": armed}), columns=columns)
    expected = np.maximum(table["throttle"], 0.0) * armed
    np.testing.assert_array_equal(dataset.episodes[0].controls[:, 0], expected[:-1])
    negative = np.flatnonzero(table["throttle"] < 0)
    assert (
        f"log.csv, row {negative[0] + 2}, column 'throttle': negative values of 'drive' set to 0 "
        f"({len(negative)} such rows)" in dataset.notes
    )
    assert "control 'drive' is 'throttle' times 'armed', 0 in 33% of the rows" in dataset.notes


def in_words(table):
    words = np.array(["right", "straight", "left"])[(table["steering"] + 1).astype(int)]
    return {**table, "steering": words}


def test_commands_in_words_become_levels(table, columns_file, tmp_path):
    words = '"steering", words = { right = -1.0, straight = 0.0, left = 1.0 }'
    columns = columns_file(('"steering", levels = [-1.0, 0.0, 1.0]', words))
    frame, path = pd.DataFrame(in_words(table)), tmp_path / "log.csv"
    frame.to_csv(path, index=False)
    frame.to_parquet(tmp_path / "log.parquet")
    for log in (path, tmp_path / "log.parquet"):
        dataset = Dataset.read(log, columns=columns)
        assert dataset.system.controls[1].levels == (-1.0, 0.0, 1.0)
        np.testing.assert_array_equal(dataset.episodes[0].controls[:, 1], table["steering"][:-1])
    path.write_text(path.read_text().replace("right", "rihgt", 1))
    with pytest.raises(InvalidData, match=r"log.csv, row \d+, column 'steering': control 'steer' is 'rihgt', expected"):
        Dataset.read(path, columns=columns)
    with pytest.raises(InvalidData, match="words: Dictionary should have at least 2 items"):
        load_columns(columns_file(('"steering", levels = [-1.0, 0.0, 1.0]', '"steering", words = { left = 1.0 }')))


def test_a_column_of_words_without_numbers_gives_an_error_with_a_remedy(table, columns_file, tmp_path):
    frame, path = pd.DataFrame(in_words(table)), tmp_path / "log.csv"
    frame.to_csv(path, index=False)
    frame.to_parquet(tmp_path / "log.parquet")
    for log in (path, tmp_path / "log.parquet"):
        with pytest.raises(InvalidData, match=r"'steering': expected .* needs .* words = \{stop = 0.0, go = 1.0\}"):
            Dataset.read(log, columns=columns_file())


def test_limits_default_to_the_range_of_all_files_and_are_listed(write_csv, table, columns_file):
    columns = columns_file((", low = -1.0, high = 1.0", ""))
    second = {**table, "throttle": 0.5 * table["throttle"] + 2.0}
    dataset = Dataset.read([write_csv(table), write_csv(second, "second.csv")], columns=columns)
    drive, steer = dataset.system.controls
    assert (drive.low, drive.high) == (table["throttle"].min(), second["throttle"].max())
    assert steer.levels == (-1.0, 0.0, 1.0)
    assert "control 'drive' has no limits in the column map: -0.8 to 2.4, as recorded" in [
        note.replace(f"{drive.low:g}", "-0.8") for note in dataset.notes
    ]


def test_a_log_without_time_is_taken_to_be_regular(write_csv, table, columns_file):
    columns = columns_file(('[time]\ncolumn = "t"\n', ""))
    del table["t"]
    dataset = Dataset.read(write_csv(table), columns=columns)
    assert len(dataset.episodes[0]) == 200
    assert any(note.startswith("no time column: rows are assumed to be 0.05 s apart") for note in dataset.notes)


def test_a_fast_log_that_carries_velocities_is_filtered_and_decimated(make_drive, write_csv, columns_file):
    drive = make_drive(frequency=0.5)
    forward, _, yaw_rate = drive.velocity(drive.time).T
    zero = np.zeros_like(forward)
    x, y, yaw = drive.pose.T
    path = write_csv(
        {"t": drive.time, "x": x, "y": y, "yaw": yaw, "u": forward, "r": yaw_rate, "throttle": zero, "steering": zero}
    )
    recording = read_recording(path, columns=columns_file())
    (episode,) = Dataset.of_recording(recording)
    assert len(recording.remarks) == 2
    ticks = (4 + np.arange(len(episode) + 1)) * 0.05
    assert np.abs(episode.states - drive.velocity(ticks)[:, [0, 2]]).max() < 0.01


@pytest.mark.parametrize("name", shipped_names())
def test_every_shipped_map_is_valid_and_chosen_for_its_own_columns(name):
    columns = shipped_columns()[name]
    assert columns.system(dict.fromkeys(columns.controls, (0.0, 1.0))).nx == 3
    assert choose_columns([*columns.columns, "something else"], "log.csv") == name
    assert load_columns(name) == columns


def test_no_map_fits_or_several_do():
    with pytest.raises(InvalidData, match=r"log.csv: no shipped column map fits its columns \(a, b\)"):
        choose_columns(["a", "b"], "log.csv")
    first, second = shipped_columns()["dart_20hz"].columns, shipped_columns()["f1tenth_20hz"].columns
    with pytest.raises(InvalidData, match=r"dart_20hz, dart_20hz_ungated, f1tenth_20hz all fit its columns"):
        choose_columns([*first, *second], "log.csv")


def test_a_note_on_all_logs_is_listed_once(write_csv, table, columns_file):
    columns = columns_file(('[time]\ncolumn = "t"\n', ""))
    files = [write_csv(table, f"run{i}.csv") for i in range(6)]
    notes = Dataset.read(files, columns=columns).notes
    assert [note for note in notes if "rows taken" in note] == ["all 6 logs: rows taken as samples every 50 ms"]
    assert not any("stamps" in note for note in notes)


def test_what_is_true_of_some_logs_names_them():
    prepared = [PreparedLog(f"run{i}", (), ("late", *(["early"] if i < 5 else []))) for i in range(6)]
    assert merged_notes(prepared) == ["all 6 logs: late", "run0, run1, run2, run3 and 1 more: early"]
    assert merged_notes(prepared[:1]) == ["run0: late", "run0: early"]


def test_a_periodic_angle_in_degrees_comes_round_after_two_pi(write_csv, tmp_path):
    path = tmp_path / "wheel.toml"
    path.write_text(
        'name = "wheel"\ndt = 0.1\n[states]\nangle = { column = "a", unit = "deg", periodic = true }\n[controls]\n'
        'push = { column = "p", low = -1.0, high = 1.0 }\n'
    )
    angle = (np.arange(50.0) * 30.0 + 180.0) % 360.0 - 180.0
    data = Dataset.read(write_csv({"a": angle, "p": np.linspace(-1.0, 1.0, 50)}), columns=path)
    assert data.system.states[0].period == pytest.approx(2.0 * np.pi)
    np.testing.assert_allclose(np.diff(data.episodes[0].states[:, 0]), np.radians(30.0))


MOTOR = """
name = "motor"
dt = 0.05
[time]
column = "t"
unit = "ms"
[states]
angle = { column = "enc", unit = "deg", periodic = true }
speed = { derivative_of = "angle", unit = "rad/s" }
[controls]
volts = { column = "u", low = -1.0, high = 1.0, hold = true }
"""


@pytest.fixture
def motor(tmp_path):
    """A function that writes 4 s of a motor at 100 Hz, whose command stands in every fifth row only; it returns the map
    and the log."""

    def write(*changes, first=0, command="{:g}"):
        text = MOTOR
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        time = np.arange(401) / 100.0
        angle = np.degrees(3.0 * time + 0.5 * np.sin(4.0 * time)) % 360.0
        rows = ["t,enc,u"]
        for k, (at, value) in enumerate(zip(time, angle, strict=True)):
            logged = command.format((-1.0) ** (k // 50)) if k % 5 == 0 and k >= first else ""
            rows.append(f"{1000 * at:g},{value:.9f},{logged}")
        (tmp_path / "motor.toml").write_text(text)
        (tmp_path / "run.csv").write_text("\n".join(rows))
        return {"columns": tmp_path / "motor.toml", "paths": tmp_path / "run.csv"}

    return write


def test_the_speed_of_an_encoder_is_the_derivative_of_its_angle(motor):
    data = Dataset.read(**motor())
    (episode,) = data.episodes
    angle, speed = episode.states.T
    time = (np.unwrap(angle) - np.unwrap(angle)[0]).searchsorted(0.0) + np.arange(len(angle)) * 0.05 + 0.25
    np.testing.assert_allclose(speed, 3.0 + 2.0 * np.cos(4.0 * time), atol=0.01)  # the filter loses 0.5 % at 1 Hz
    assert data.system.states[1].unit == "rad/s"
    assert "speed from angle (5-point differences)" in " ".join(data.notes)


def test_a_held_command_is_that_of_the_last_row_with_one(motor):
    data = Dataset.read(**motor())
    (episode,) = data.episodes
    switches = np.flatnonzero(np.diff(episode.controls[:, 0]))
    np.testing.assert_array_equal(np.diff(switches), 10)
    assert "run.csv: 'u' has a value in 81 of 401 rows; held between" in data.notes
    words = Dataset.read(**motor(("low = -1.0, high = 1.0", 'words = { "+1!" = 1.0, "-1!" = -1.0 }'), command="{:+g}!"))
    np.testing.assert_array_equal(words.episodes[0].controls, episode.controls)


def test_rows_before_the_first_held_command_are_left_out_and_other_missing_numbers_are_an_error(motor):
    files = motor(first=100)
    (episode,) = Dataset.read(**files).episodes
    assert len(episode.states) == len(Dataset.read(**motor()).episodes[0].states) - 20
    path = motor()["paths"]
    lines = path.read_text().splitlines()
    lines[7] = "60,,"
    path.write_text("\n".join(lines))
    with pytest.raises(InvalidData, match=r"run.csv, row 8, column 'enc': expected a number, got ''\. Give missing"):
        Dataset.read(**files)


def test_an_angle_without_its_speed_is_noted(motor):
    rate = 'speed = { derivative_of = "angle", unit = "rad/s" }\n'
    notes = Dataset.read(**motor((rate, ""))).notes
    assert sum("no state is the speed of angle" in note and 'derivative_of = "angle"' in note for note in notes) == 1
    assert not any("no state is the speed" in note for note in Dataset.read(**motor()).notes)


def test_a_log_too_slow_for_its_dt_is_not_asked_for_states_that_it_has(motor):
    rate = 'speed = { derivative_of = "angle", unit = "rad/s" }\n'
    with pytest.raises(InvalidData, match=r"raise dt to 0.03 s, or log speed and set dt to 0.01 s"):
        Dataset.read(**motor(("dt = 0.05", "dt = 0.02")))
    with pytest.raises(InvalidData, match=r"raise dt to 0.03 s, or set dt to 0.01 s"):
        Dataset.read(**motor(("dt = 0.05", "dt = 0.02"), (rate, "")))


def test_a_log_of_commands_alone_is_refused_with_a_reason(motor):
    files = motor()
    other = files["paths"].with_name("commands.csv")
    other.write_text("t,u\n0,1\n50,-1\n")
    with pytest.raises(InvalidData, match=r"column 'enc' is missing\. Every log needs all columns .* has: t, u\."):
        Dataset.read(other, columns=files["columns"])


def test_a_clock_that_restarts_asks_for_another_file(motor):
    files = motor()
    lines = files["paths"].read_text().splitlines()
    files["paths"].write_text("\n".join([*lines, *lines[1:]]))
    with pytest.raises(InvalidData, match=r"row 403, .* 0 s is before 4 s in row 402\. If the logger was restarted"):
        Dataset.read(**files)


@pytest.mark.parametrize(
    "unit, si, factor",
    [
        ("", "", 1.0),
        ("km/h", "m/s", 1.0 / 3.6),
        ("deg/s", "rad/s", math.pi / 180.0),
        ("rpm", "rad/s", math.pi / 30.0),
        ("g", "m/s^2", 9.80665),
        ("mm/s2", "m/s^2", 1e-3),
        ("m/s/s", "m/s^2", 1.0),
        ("deg s^-1", "rad/s", math.pi / 180.0),
        ("N m", "N m", 1.0),
        ("Nm", "N m", 1.0),
        ("mN*m/rad", "N m/rad", 1e-3),
        ("l/min", "m^3/s", 1e-3 / 60.0),
        ("1/s", "1/s", 1.0),
        ("degC", "degC", 1.0),
        ("%", "%", 1.0),
        ("[ticks]", "ticks", 1.0),
        ("[counts/s]", "counts/s", 1.0),
    ],
)
def test_a_unit_becomes_its_si_unit(unit, si, factor):
    assert to_si(unit) == (si, pytest.approx(factor))


@pytest.mark.parametrize(
    "unit, named, meant",
    [
        ("radd/s", "radd", "rad/s"),
        ("m/sec", "sec", ""),
        ("volt", "volt", ""),
        ("m/s**2", "2", ""),
        ("kmh", "kmh", "km"),
    ],
)
def test_a_slip_of_the_pen_is_refused_with_a_suggestion(unit, named, meant):
    with pytest.raises(InvalidArgument, match=rf"got '{unit}': '{named}' is not one".replace("*", r"\*")) as caught:
        to_si(unit)
    assert f'in brackets: "[{unit}]"' in str(caught.value)
    if meant:
        assert f"Did you mean '{meant}'?" in str(caught.value)


def test_a_column_map_with_a_wrong_unit_names_the_key(columns_file):
    with pytest.raises(InvalidData, match=r"states.yaw_rate.unit: expected a unit made of.*Did you mean 'rad/s'\?"):
        load_columns(columns_file(('unit = "rad/s"', 'unit = "radd/s"')))
    own = load_columns(columns_file(('column = "throttle"', 'column = "throttle", unit = "[ticks]"')))
    assert own.system({}).controls[0].unit == "ticks"


def test_a_refused_role_lists_the_units_that_fit():
    assert units_of("rad/s") == ("rad/s", "deg/s", "rpm")
    assert units_of("rad") == ("rad", "mrad", "deg", "rev")


@pytest.mark.parametrize(
    "value, among, text",
    [
        (1100.0, (1000.0, 2000.0), "1100"),
        (1466.0, (), "1466"),
        (3.14e-6, (-3.14, 3.14), "0"),
        (-1e-9, (1.0,), "0"),
        (0.00314, (), "0.00314"),
        (3.14e-8, (), "3.14e-08"),
        (0.5, (0.5, -1.0), "0.5"),
        (0.0, (), "0"),
        (12.345, (), "12.3"),
        (math.inf, (), "inf"),
    ],
)
def test_a_value_has_three_digits_of_its_range_and_no_exponent_where_there_is_a_way(value, among, text):
    assert spelled(value, among) == text


def test_a_range_is_written_with_the_digits_of_its_larger_end():
    assert spelled_range(-0.00000314, 2.5) == "0 to 2.5"
    assert spelled_range(1000.0, 2000.0) == "1000 to 2000"
    assert spelled_range(1.0, 1.0) == "1"
