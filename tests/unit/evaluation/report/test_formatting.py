"""Numbers have the digits that their error leaves; zero has no sign; names where space is short."""

import numpy as np
import pytest

from evaluation.formatting import (
    by_error,
    few,
    folded,
    number,
    percent,
    plus_minus,
    three_digits,
    with_interval,
    within,
)
from sysid_evo.validation.estimates import Estimate


@pytest.mark.parametrize(
    "value, error, text",
    [
        (11.5, 0.3, "11.5 ±0.3"),
        (0.9123, 0.0121, "0.912 ±0.012"),  # an error that begins with 1 has two digits
        (0.9123, 0.021, "0.91 ±0.02"),
        (-0.00312, 0.04, "0.00 ±0.04"),
        (-1234.5, 212.0, "-1234 ±212"),
        (11.5, 2.6, "12 ±3"),
        (11.5, 1.6, "11.5 ±1.6"),
        (0.9, 0.0, "0.900 ±0"),
        (5.0, np.nan, "5.00"),
        (1.23e-4, 2e-5, "0.00012 ±0.00002"),
    ],
)
def test_a_value_has_the_digits_that_its_standard_error_leaves(value, error, text):
    assert plus_minus(Estimate(value, error)) == text


def test_an_interval_has_the_digits_of_its_width_and_none_without_one():
    assert with_interval(8.84, 7.62, 9.41) == "8.8 (7.6 to 9.4)"
    assert with_interval(0.9123, 0.9011, 0.9201) == "0.912 (0.901 to 0.920)"
    assert with_interval(1.0, 1.0, 1.0) == with_interval(1.0, np.nan, np.nan) == "1.00"
    assert within(Estimate(0.52, 0.03, 0.47, 0.57)) == "0.52\n0.47 to 0.57"
    assert within(Estimate(0.52, np.nan)) == "0.520"


def test_what_is_rounded_to_zero_has_no_sign():
    assert number(-0.04) == "0.0"
    assert by_error(-0.0004, 0.02) == "0.00"
    assert number(-0.06) == "-0.1"


@pytest.mark.parametrize(
    "value, text",
    [(0.0461, "0.046"), (0.9994, "0.999"), (0.9996, "1.00"), (1.234, "1.23"), (12.34, "12.3"), (123.4, "123")],
)
def test_numbers_have_three_digits_and_keep_their_leading_zero(value, text):
    assert three_digits(value) == text
    assert three_digits(-value) == f"-{text}"
    assert three_digits(float("nan")) == number(None) == "–"


@pytest.mark.parametrize(
    "name, lines",
    [
        ("linear", ["linear"]),
        ("nearest_neighbour", ["nearest_", "neighbour"]),
        ("linear+nearest_neighbour", ["linear+", "nearest_", "neighbour"]),
        ("withoutanyplacetobreak", ["withoutanyplacetobreak"]),
        ("linear\nclip 0.4 %, 2 s", ["linear", "clip 0.4 %, ", "2 s"]),
    ],
)
def test_names_break_after_their_joints(name, lines):
    assert folded(name, 12).split("\n") == lines


@pytest.mark.parametrize("number, text", [(0, ""), (2, "a, b"), (3, "a, b, c"), (4, "a, b and 2 more")])
def test_of_many_names_the_first_stand_there(number, text):
    assert few("abcd"[:number], 2) == text


@pytest.mark.parametrize(
    "share, text",
    [
        (None, "–"),
        (float("nan"), "–"),
        (0.0, "0 %"),
        (0.0004, "<0.1 %"),
        (0.0006, "0.1 %"),
        (0.0994, "9.9 %"),
        (0.0996, "10 %"),
        (1.0, "100 %"),
    ],
)
def test_a_share_has_a_decimal_below_ten_per_cent(share, text):
    assert percent(share) == text
