"""Names where space is short."""

from __future__ import annotations

import pytest

from evaluation.labels import folded, shortened


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


def test_a_shortened_name_keeps_both_ends() -> None:
    assert shortened("abcdefghij", 10) == "abcdefghij"
    short = shortened("first_and_very_long_name_last", 12)
    assert len(short) == 12
    assert short.startswith("first")
    assert short.endswith("_last")
