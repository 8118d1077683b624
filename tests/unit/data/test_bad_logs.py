"""Every bad log is refused, or doubted, by a message that names file, row and column."""

import numpy as np
import pandas as pd
import pytest

from sysid_evo.data import Dataset, read_recording
from sysid_evo.errors import DataWarning, InvalidData


def refused(path, columns):
    with pytest.raises(InvalidData) as caught:
        Dataset.read(path, columns=columns)
    return str(caught.value)


def remarks(path, columns):
    return read_recording(path, columns=columns).remarks


def with_value(path, row, column, text):
    """Put ``text`` into a cell; ``row`` counts as an editor does."""
    lines = path.read_text().splitlines()
    cells = lines[row - 1].split(",")
    cells[column] = text
    lines[row - 1] = ",".join(cells)
    path.write_text("\n".join(lines))
    return path


class Log:
    """The made-up log, to be spoilt, and what is said of it with changes of the column map."""

    def __init__(self, table, write, columns):
        self.table, self.write, self.columns = table, write, columns

    def read(self, *changes):
        return Dataset.read(self.write(self.table), columns=self.columns(*changes))

    def refused(self, *changes):
        return refused(self.write(self.table), self.columns(*changes))

    def remarks(self, *changes):
        return remarks(self.write(self.table), self.columns(*changes))


@pytest.fixture
def log(table, write_csv, columns_file):
    return Log(table, write_csv, columns_file)


def test_the_made_up_log_is_flawless(log):
    dataset = log.read()  # a warning would be an error
    assert not any("log.csv" in note for note in dataset.notes)
    np.testing.assert_array_equal(dataset.episodes[0].states, np.stack([log.table["u"], log.table["r"]], axis=1))


@pytest.mark.parametrize(
    "row, column, text, complaint",
    [
        (17, "u", "nan", 'expected a finite number, got nan. Give missing = "drop"'),
        (17, "u", "inf", "got inf"),
        (17, "u", "", "expected a number, got ''. Give missing = \"drop\""),
        (17, "u", "1.5m", "'1.5m'"),
        (12, "throttle", "1.25", "column 'throttle': control 'drive' is 1.25, expected -1 to 1"),
        (12, "steering", "0.5", "column 'steering': control 'steer' is 0.5, expected one of -1, 0, 1"),
        (40, "t", "0.01", "0.01 s is before 1.85 s in row 39"),
        (40, "t", "1.85", "is the same as"),
    ],
)
def test_a_cell_that_cannot_be(log, row, column, text, complaint):
    path = with_value(log.write(log.table), row, list(log.table).index(column), text)
    message = refused(path, log.columns())
    assert f"log.csv, row {row}, column '{column}'" in message
    assert complaint in message


def test_a_column_that_is_not_used_may_hold_anything(write_csv, table, columns_file):
    path = write_csv({**table, "comment": np.zeros(len(table["t"]))})
    with_value(path, 17, 8, "driver sneezed")
    assert len(Dataset.read(path, columns=columns_file())) == 1


def test_a_short_row(write_csv, table, columns_file):
    path = write_csv(table)
    lines = path.read_text().splitlines()
    lines[29] = lines[29].rpartition(",")[0]
    path.write_text("\n".join(lines))
    assert "log.csv, row 30: expected 8 values as in the header, got 7, so 'steering' is missing" in refused(
        path, columns_file()
    )


def test_a_state_beyond_its_limits_is_not_changed_and_gets_a_remark(write_csv, table, columns_file):
    columns = columns_file(('column = "u", unit = "m/s"', 'column = "u", unit = "m/s", low = 0.0, high = 1.4'))
    (remark,) = remarks(write_csv(table), columns)
    first = int(np.flatnonzero(table["u"] > 1.4)[0]) + 2
    assert f"log.csv, row {first}, column 'u': state 'forward_speed' is" in remark
    with pytest.warns(DataWarning, match="outside 0 to 1.4"):
        dataset = Dataset.read(write_csv(table), columns=columns)
    assert dataset.episodes[0].states[:, 0].max() > 1.4
    assert remark in dataset.notes


def test_a_control_that_is_constant_in_every_file(write_csv, table, columns_file):
    steady = {**table, "throttle": np.full(201, 0.25)}
    (remark,) = remarks(write_csv(steady), columns_file())
    assert "log.csv, every row, column 'throttle': control 'drive' is constant at 0.25" in remark
    unlimited = columns_file((", low = -1.0, high = 1.0", ""))
    assert "control 'drive' (column 'throttle') is 0.25 in every row" in refused(write_csv(steady), unlimited)
    both = [write_csv(steady), write_csv(table, "second.csv")]
    assert remarks(both, columns_file()) == ()


def test_a_state_that_is_constant_in_one_file(write_csv, table, columns_file):
    dead = {**table, "r": np.full(201, 0.01)}
    both = [write_csv(table), write_csv(dead, "second.csv")]
    assert (
        "second.csv, rows 2 to 202, column 'r': state 'yaw_rate' is constant at 0.01"
        in remarks(both, columns_file())[0]
    )


def test_a_heading_in_degrees_that_wraps(write_csv, table, columns_file):
    table["yaw"] = (np.degrees(table["yaw"]) - 90.0) % 360.0
    table["r"] = np.zeros_like(table["r"])
    message = refused(write_csv(table), columns_file())
    row = int(np.flatnonzero(np.abs(np.diff(table["yaw"])) > 300.0)[0]) + 3
    assert f"log.csv, row {row}, column 'yaw'" in message
    assert 'declare unit = "deg"' in message


def unwrapped(table):
    table["yaw"] = np.unwrap(table["yaw"])


def on_the_spot(table):
    """Turn without moving, so that only the yaw rate tells about the heading."""
    table["x"], table["y"] = np.zeros(201), np.zeros(201)
    unwrapped(table)


def in_degrees(table, name="yaw"):
    table[name] = np.degrees(table[name])


def clockwise(table):
    table["yaw"] = -table["yaw"]


AS_DEGREES = ('"yaw", unit = "rad"', '"yaw", unit = "deg"')
RATE_AS_DEGREES = ('"r", unit = "rad/s"', '"r", unit = "deg/s"')
UNTIMED = ('[time]\ncolumn = "t"\n', "")
IN_MILLISECONDS = ('column = "t"', 'column = "t"\nunit = "ms"')


@pytest.mark.parametrize(
    "spoilt, changes, complaints",
    [
        ([lambda t: t.update(Throtle=t.pop("throttle"))], [],
         ["log.csv, row 1: column 'throttle' is missing. Did you mean 'Throtle'?"]),
        ([on_the_spot, in_degrees], [],
         ["log.csv, rows 2 to 202, column 'r': the yaw rate is not the derivative of the heading",
          "column 'yaw' looks like deg, but rad is declared: give it unit = 'deg'"]),
        ([unwrapped, in_degrees], [],
         ["log.csv, rows 2 to 202, column 'yaw': the heading follows the motion only if it is in degrees"]),
        ([lambda t: in_degrees(t, "r")], [], ["column 'r' looks like deg/s, but rad/s is declared"]),
        ([], [RATE_AS_DEGREES], ["column 'r' looks like rad/s, but deg/s is declared"]),
        ([unwrapped], [AS_DEGREES], ["column 'yaw': the heading follows the motion only if it is in radians"]),
        ([on_the_spot], [AS_DEGREES],
         ["column 'yaw' looks like rad, but deg is declared", "column 'r' looks like deg/s, but rad/s is declared"]),
        ([clockwise], [], ["log.csv, rows 2 to 202, column 'yaw': the heading is counted clockwise"]),
        ([clockwise, on_the_spot], [], ["one of them is counted clockwise; give it factor = -1"]),
        ([lambda t: t.update(t=0.5 * t["t"])], [],
         ["log: expected at least 3 rows for each control period of 0.05 s, but rows are 0.025 s apart",
          "raise dt to 0.075 s, or set dt to 0.025 s"]),
        ([], [("dt = 0.05", "dt = 0.005")],
         ["column 't': the rows are 0.05 s apart, but dt is 0.005 s, 10 times shorter",
          "Set dt = 0.05 in the column map"]),
        ([], [("dt = 0.05", "dt = 0.025")],
         ["column 't': the rows are 0.05 s apart, but dt is 0.025 s, 2 times shorter",
          "Set dt = 0.05 in the column map"]),
        ([], [IN_MILLISECONDS],
         ["declared in ms, 201 rows last only 0.01 s, with dt = 0.05 s. Are the stamps in s?"]),
    ],
)  # fmt: skip
def test_a_log_of_wrong_names_units_or_signs_is_refused(log, spoilt, changes, complaints):
    for spoil in spoilt:
        spoil(log.table)
    message = log.refused(*changes)
    for complaint in complaints:
        assert complaint in message
    assert "scatters" not in message


def test_degrees_that_are_declared_are_radians(log):
    on_the_spot(log.table)
    in_degrees(log.table)
    assert log.remarks(AS_DEGREES) == ()
    turned = log.table["r"].copy()
    in_degrees(log.table, "r")
    np.testing.assert_allclose(log.read(AS_DEGREES, RATE_AS_DEGREES).episodes[0].states[:, 1], turned)


def test_a_heading_that_points_sideways(log):
    unwrapped(log.table)
    log.table["yaw"] -= np.radians(60.0)
    (remark,) = log.remarks()
    assert "log.csv, rows 2 to 202, column 'yaw': the body moves 60 degrees to the left of its heading" in remark


def test_a_heading_that_jumps(log):
    unwrapped(log.table)
    log.table["yaw"][100] += 2.5
    remark = log.remarks()[0]
    assert "log.csv, row 102, column 'yaw': the heading jumps by 2.5" in remark
    assert "2 such rows" in remark


def test_a_pose_that_freezes_and_jumps(log):
    for name in ("x", "y", "yaw"):
        log.table[name][60:70] = log.table[name][60]
    (remark,) = [remark for remark in log.remarks() if "is constant" in remark]
    assert "log.csv, rows 62 to 71: the pose is constant for 0.45 s and then jumps by" in remark


def test_an_empty_file_and_a_header_alone(tmp_path, columns_file):
    path = tmp_path / "empty.csv"
    path.write_text("")
    assert "empty.csv: expected a header line" in refused(path, columns_file())
    path.write_text("t,x,y,yaw,u,r,throttle,steering\n")
    assert "empty.csv: expected at least two rows of data, got 0" in refused(path, columns_file())


DROP = ("dt = 0.05", 'dt = 0.05\nmissing = "drop"')


@pytest.mark.parametrize("kind", ["csv", "line by line", "parquet"])
def test_rows_without_a_value_are_left_out_and_split_the_log_if_the_map_allows_it(
    write_csv, table, columns_file, tmp_path, kind
):
    path = write_csv(table)
    for row, column, text in ((17, 4, ""), (18, 4, "nan"), (18, 6, ""), (90, 1, "NA"), (91, 7, "null")):
        with_value(path, row, column, text)
    if kind == "line by line":
        path.write_text(path.read_text().replace("\n", "\n\n", 1))
    if kind == "parquet":
        frame = pd.read_csv(path)
        path = tmp_path / "log.parquet"
        frame.to_parquet(path)
    dataset = Dataset.read(path, columns=columns_file(DROP))
    assert dataset.names == ("log[0:14]", "log[15:85]", "log[86:196]")
    np.testing.assert_array_equal(dataset.episodes[1].states[:, 0], table["u"][17:88])
    first = {"csv": 17, "line by line": 18, "parquet": 16}[kind]
    left_out = "(u 2, throttle 1, steering 1, x 1) and are left out, the first is row"
    told = f"4 of 201 rows have no value in some column {left_out} {first}; the log has gaps there"
    assert f"{path.name}: {told}" in dataset.notes
    assert any("2 steps outside 25 to 75 ms split it into 3 parts" in note for note in dataset.notes)


def test_without_time_stamps_rows_that_are_left_out_are_holes_too_and_infinite_numbers_stay_errors(
    write_csv, table, columns_file
):
    untimed = columns_file(DROP, UNTIMED)
    path = with_value(with_value(write_csv(table), 60, 5, ""), 61, 5, "")
    assert Dataset.read(path, columns=untimed).names == ("log[0:57]", "log[58:198]")
    assert "row 70, column 'u': expected a finite number, got inf" in refused(with_value(path, 70, 4, "inf"), untimed)
    table["u"][1:] = np.nan
    assert "200 of 201 rows have no value in some column (u 200): expected at least two complete rows" in (
        refused(write_csv(table), untimed)
    )


def test_commands_in_words_may_be_missing_too(write_csv, table, columns_file):
    words = {-1.0: "right", 0.0: "none", 1.0: "left"}
    path = write_csv({**table, "steering": np.array([words[value] for value in table["steering"]])})
    path.write_text(path.read_text().replace("'", ""))
    with_value(path, 30, 7, "")
    steer = ("levels = [-1.0, 0.0, 1.0]", "words = { right = -1.0, none = 0.0, left = 1.0 }")
    assert "control 'steer' is '', expected one of" in refused(path, columns_file(steer))
    dataset = Dataset.read(path, columns=columns_file(steer, DROP))
    assert dataset.names == ("log[0:27]", "log[28:199]")
    np.testing.assert_array_equal(dataset.episodes[1].controls[:, 1], table["steering"][29:200])


def test_limits_in_the_unit_of_the_column_where_si_is_meant(write_csv, table, columns_file):
    table["throttle"] = 4000.0 * table["throttle"]  # mA
    wrong = columns_file(("low = -1.0, high = 1.0", 'unit = "mA", low = -5000.0, high = 5000.0'))
    (remark,) = remarks(write_csv(table), wrong)
    assert (
        "log.csv, column 'throttle': 'drive' goes from -3.1999 to 3.2 A, 0.00064 of the range of its limits" in remark
    )
    assert "-5000 to 5000 A: limits are in SI units. Are they in mA? Then give low = -5, high = 5" in remark
    right = columns_file(("low = -1.0, high = 1.0", 'unit = "mA", low = -5.0, high = 5.0'))
    assert remarks(write_csv(table), right) == ()
    unknown = columns_file(("low = -1.0, high = 1.0", 'unit = "mA", low = -2000.0, high = 2000.0'))
    assert remarks(write_csv(table), unknown)[0].endswith("limits are in SI units. Are they right?")
    of_state = columns_file(
        ("low = -1.0, high = 1.0", 'unit = "mA", low = -5.0, high = 5.0'),
        ('unit = "rad/s" }', 'unit = "rad/s", low = -200.0, high = 200.0 }'),
    )
    assert remarks(write_csv(table), of_state) == (), "limits of a state may be wide"
    table["r"] = np.degrees(table["r"])
    of_state.write_text(of_state.read_text().replace("rad/s", "deg/s").replace("200.0", "120.0"))
    assert "Are they in deg/s? Then give low = -2.0944, high = 2.0944" in remarks(write_csv(table), of_state)[0]


PENDULUM = """
name = "pendulum"
dt = 0.02
[states]
theta = { column = "angle", unit = "rad", periodic = true }
theta_dot = { column = "rate", unit = "rad/s" }
[controls]
torque = { column = "torque", unit = "N m", low = -1.0, high = 1.0 }
"""


def turning(write_csv, tmp_path, rng, angle=1.0, rate=1.0, *, text=PENDULUM):
    """Return a log of a pendulum that goes round, in other units and a little noisy, and its column map."""
    time = 0.02 * np.arange(2000)
    theta, theta_dot = 5.0 * np.sin(0.7 * time), 3.5 * np.cos(0.7 * time)
    wrapped = np.arctan2(np.sin(theta), np.cos(theta)) + 0.002 * rng.standard_normal(2000)
    noisy = theta_dot + 0.1 * rng.standard_normal(2000)
    (tmp_path / "pendulum.toml").write_text(text)
    path = write_csv({"angle": angle * wrapped, "rate": rate * noisy, "torque": np.sin(3.0 * time)})
    return path, tmp_path / "pendulum.toml"


DEGREES = 180.0 / np.pi


@pytest.mark.parametrize(
    ("angle", "rate", "looks"),
    [
        (DEGREES, 1.0, "column 'angle' looks like deg, but rad is declared: give it unit = 'deg'"),
        (1.0, DEGREES, "column 'rate' looks like deg/s, but rad/s is declared: give it unit = 'deg/s'"),
        (1.0, 30.0 / np.pi, ""),
    ],
)
def test_a_rate_that_is_not_the_derivative_of_its_state(write_csv, tmp_path, rng, angle, rate, looks):
    path, columns = turning(write_csv, tmp_path, rng, angle, rate)
    if not looks:  # a factor of 9.5 is rpm, or a gear
        assert not any("derivative" in remark for remark in remarks(path, columns))
        return
    message = refused(path, columns)
    assert (
        "log.csv, rows 2 to 2001, column 'rate': it is proportional to the change of column 'angle', but is not"
        in message
    )
    assert looks in message
    columns.write_text(PENDULUM.replace('"rad/s"', '"[rad/s]"'))
    assert not any("derivative" in remark for remark in remarks(path, columns)), "there is a way to have it so"


def test_radians_declared_as_degrees_in_states(write_csv, tmp_path, rng):
    declared = PENDULUM.replace('"rad"', '"deg"')
    assert "column 'angle' looks like rad, but deg is declared" in refused(
        *turning(write_csv, tmp_path, rng, text=declared)
    )
    assert remarks(*turning(write_csv, tmp_path, rng)) == ()


def test_a_rate_of_another_joint_is_no_mistake(write_csv, tmp_path, rng):
    """The motor turns 57 times as fast as the arm, whose own rate is there as well."""
    motor = PENDULUM.replace("[controls]", 'motor = { column = "motor", unit = "rad/s" }\n[controls]')
    path, columns = turning(write_csv, tmp_path, rng, text=motor)
    head, *rows = path.read_text().splitlines()
    geared = [f"{row},{57.0 * float(row.split(',')[1])}" for row in rows]
    path.write_text("\n".join([f"{head},motor", *geared]))
    assert remarks(path, columns) == ()


def test_degrees_in_both_angle_and_rate_get_a_remark(write_csv, tmp_path, rng):
    (remark,) = remarks(*turning(write_csv, tmp_path, rng, DEGREES, DEGREES))
    assert "column 'angle': state 'theta' reaches 1" in remark
    assert "full turns. Are these degrees? Then give unit = 'deg'" in remark


def test_a_yaw_rate_in_degrees_gets_a_remark_without_a_pose(log):
    in_degrees(log.table, "r")
    text = log.columns().read_text()
    (remark,) = log.remarks((text[text.index("[pose]") :], ""))
    assert "state 'yaw_rate' reaches" in remark
    assert "Then give unit = 'deg/s'" in remark


@pytest.mark.parametrize("unit, factor", [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_a_unit_of_time_that_is_not_declared(log, unit, factor):
    log.table["t"] = factor * log.table["t"]
    message = log.refused()
    assert f"column 't': declared in s, the rows are {0.05 * factor:.4g} s apart" in message
    assert f"Are the stamps in {unit}? Then give [time] unit = '{unit}'" in message
    assert len(log.read(('column = "t"', f'column = "t"\nunit = "{unit}"')).episodes[0]) == 200


def test_stamps_that_scatter_by_two_fifths_of_a_step(log, rng):
    log.table["t"] = log.table["t"] + rng.uniform(-0.02, 0.02, 201)
    message = log.refused()
    assert "column 't': the time between rows scatters by 16.6 ms around 50 ms; 14% of the steps" in message
    assert "leave [time] out of the column map" in message
    assert len(log.read(UNTIMED).episodes[0]) == 200


def test_lost_rows_are_no_scatter(log, rng):
    kept = np.sort(rng.choice(201, 150, replace=False))
    log.table = {name: column[kept] for name, column in log.table.items()}
    assert len(log.read()) > 10
