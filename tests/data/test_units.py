"""Units of a log: what they become, and which are refused."""

import math

import pytest

from sysid_evo.data import load_columns
from sysid_evo.data.units import spelled, spelled_range, to_si, units_of
from sysid_evo.errors import InvalidArgument, InvalidData


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
