"""Names where space is short."""

from __future__ import annotations

import pytest

from evaluation.formatting import few, folded, percent


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
def test_names_break_after_their_joints(name: str, lines: list[str]) -> None:
    assert folded(name, 12).split("\n") == lines
    assert folded(name, 12).replace("\n", "") == name.replace("\n", "")


@pytest.mark.parametrize(
    "number, text",
    [(0, ""), (2, "a, b"), (3, "a, b, c"), (4, "a, b and 2 more")],
)
def test_of_many_names_the_first_stand_there(number: int, text: str) -> None:
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
def test_a_share_has_a_decimal_below_ten_per_cent(share: float | None, text: str) -> None:
    assert percent(share) == text
