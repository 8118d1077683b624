"""Where arrays of kernels lie in memory."""

from __future__ import annotations

import numpy as np
import pytest

from sysid_evo.engine.compiled.workspace import CACHE_LINE, SMALL, aligned, empty_lines, together


def begin(array: np.ndarray) -> int:
    return int(array.__array_interface__["data"][0])


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_zeros_and_copies_begin_on_a_cache_line(precision: str) -> None:
    assert begin(empty_lines(3, precision)) % CACHE_LINE == 0
    copied = aligned(np.arange(6.0).reshape(2, 3), precision)
    assert begin(copied) % CACHE_LINE == 0
    assert copied.dtype == precision
    assert copied.tolist() == [0, 1, 2, 3, 4, 5]


def test_there_is_always_one_number_to_point_at() -> None:
    assert len(empty_lines(0, "float32")) == 1
    assert len(together({"none": 0}, "float32")["none"]) == 1


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_what_is_used_together_lies_one_after_the_other(precision: str) -> None:
    small, large = aligned(np.arange(5.0), precision), aligned(np.ones(SMALL + 1), precision)
    found = together({"a": 3, "b": 40}, precision, copies={"small": small, "large": large})
    assert [len(found[name]) for name in ("a", "b", "small")] == [3, 40, 5]
    begins = [begin(found[name]) for name in ("a", "b", "small")]
    assert all(first % CACHE_LINE == 0 for first in begins)
    gaps = np.diff(begins) - np.array([3, 40]) * found["a"].itemsize
    assert ((gaps >= 0) & (gaps < CACHE_LINE)).all()
    assert found["small"].tolist() == small.tolist()
    assert found["large"] is large
    assert not found["a"].any()
    assert not found["b"].any()


def test_a_copy_is_a_copy() -> None:
    given = aligned(np.ones(4))
    together({}, "float64", copies={"given": given})["given"][:] = 2.0
    assert given.tolist() == [1.0] * 4
