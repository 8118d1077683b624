"""Rows as values: every operation on 64 lanes is what NumPy does, in both precisions."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from sysid_evo import kernels
from sysid_evo.engine.compiled import vectors
from sysid_evo.engine.compiled.compiler import compile_kernel
from sysid_evo.kernels import (
    LANES,
    QUARTER,
    REALS,
    WHOLES,
    WORDS,
    KernelSource,
    Precision,
    Signature,
    first_lane,
    lanes_at_most,
    lanes_differ,
    lanes_less,
    load,
    load_quarter,
    look_up,
    splat,
    store,
    where_at_most,
    where_bits,
    where_less,
)
from tests.sysid_evo.engine.running import PRECISIONS

RNG = np.random.default_rng(3)
A, B = RNG.normal(size=LANES), RNG.normal(size=LANES)
A[:4] = B[:4]  # equal ones
A[4], B[5] = np.nan, np.nan
A[6] = np.inf


def row_of(function: Callable[..., Any], precision: Precision) -> np.ndarray:
    """Return the row that ``function(a, b, y)`` writes."""
    compiled = compile_kernel(KernelSource(function), Signature(a=REALS, b=REALS, y=REALS), precision, pointer=False)
    y = np.zeros(LANES, dtype=precision)
    compiled(A.astype(precision), B.astype(precision), y)
    return y


def bits_of(function: Callable[..., Any], precision: Precision) -> np.ndarray:
    """Return the bits (64,) of the integer that ``function(a, b, y)`` writes."""
    compiled = compile_kernel(KernelSource(function), Signature(a=REALS, b=REALS, y=WHOLES), precision, pointer=False)
    y = np.zeros(1, dtype=np.int64)
    compiled(A.astype(precision), B.astype(precision), y)
    return (y.view(np.uint64)[0] >> np.arange(LANES, dtype=np.uint64)) & np.uint64(1) == 1


def arithmetic(a, b, y):
    store(y, 0, (2.0 * load(a, 0) - load(b, 0)) / 4.0 + -(load(a, 0) * load(b, 0)) + abs(load(b, 0)) * 0.5 - 1.0)


def between(a, b, y):
    store(y, 0, min(max(load(a, 0), -0.5), 0.5))


def lower(a, b, y):
    store(y, 0, min(load(a, 0), load(b, 0)))


def upper(a, b, y):
    store(y, 0, max(load(a, 0), load(b, 0)))


def chosen(a, b, y):
    store(y, 0, where_less(load(a, 0), load(b, 0), 1.0, load(b, 0)))


def chosen_at_most(a, b, y):
    store(y, 0, where_at_most(load(a, 0), load(b, 0), splat(2.0), 0.0))


def squashed(a, b, y):
    store(y, 0, math.tanh(load(b, 0)))


def differing(a, b, y):
    y[0] = lanes_differ(load(a, 0), load(b, 0))


def less(a, b, y):
    y[0] = lanes_less(load(a, 0), load(b, 0))


def at_most(a, b, y):
    y[0] = lanes_at_most(load(a, 0), load(b, 0))


def quarter_at_most(a, b, y):
    y[0] = lanes_at_most(load_quarter(a, 0), load_quarter(b, 0))


def blended(a, b, y):
    store(y, 0, where_bits(lanes_at_most(load(a, 0), load(b, 0)), load(a, 0), load(b, 0)))


def last_bit(a, b, y):
    y[0] = first_lane(lanes_less(load(a, 0), load(b, 0)) & (1 << 63))


def taken(a, b, y):
    for first in range(0, LANES, QUARTER):
        store(y, first, look_up(load_quarter(a, 0), load_quarter(b, first)))


@pytest.mark.parametrize("precision", PRECISIONS)
def test_rows_and_numbers_are_added_multiplied_and_divided(precision: Precision) -> None:
    with np.errstate(invalid="ignore"):
        expected = (2.0 * A - B) / 4.0 - A * B + np.abs(B) * 0.5 - 1.0
    np.testing.assert_allclose(row_of(arithmetic, precision), expected, rtol=1e-5)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_the_smaller_and_the_larger_of_two_rows(precision: Precision) -> None:
    known = np.isfinite(A) & np.isfinite(B)
    np.testing.assert_array_equal(row_of(lower, precision)[known], np.minimum(A, B).astype(precision)[known])
    np.testing.assert_array_equal(row_of(upper, precision)[known], np.maximum(A, B).astype(precision)[known])
    np.testing.assert_array_equal(row_of(between, precision), np.clip(A, -0.5, 0.5).astype(precision))


@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_choice_takes_the_second_where_nothing_compares(precision: Precision) -> None:
    np.testing.assert_array_equal(row_of(chosen, precision), np.where(A < B, 1.0, B).astype(precision))
    np.testing.assert_array_equal(row_of(chosen_at_most, precision), np.where(A <= B, 2.0, 0.0))


@pytest.mark.parametrize("precision", PRECISIONS)
def test_comparisons_are_bits_and_what_is_no_number_only_differs(precision: Precision) -> None:
    a, b = A.astype(precision), B.astype(precision)
    np.testing.assert_array_equal(bits_of(differing, precision), a != b)
    np.testing.assert_array_equal(bits_of(less, precision), a < b)
    np.testing.assert_array_equal(bits_of(at_most, precision), a <= b)
    np.testing.assert_array_equal(
        bits_of(quarter_at_most, precision), np.where(np.arange(LANES) < QUARTER, a <= b, False)
    )
    np.testing.assert_array_equal(row_of(blended, precision), np.where(a <= b, a, b))


def test_the_last_lane_has_a_bit_as_well() -> None:
    y = np.zeros(1, dtype=np.int64)
    signature = Signature(a=REALS, b=REALS, y=WHOLES)
    compiled = compile_kernel(KernelSource(last_bit), signature, "float64", pointer=False)
    compiled(np.zeros(LANES), np.ones(LANES), y)
    assert y[0] == LANES - 1


@pytest.mark.parametrize("precision", PRECISIONS)
def test_the_tanh_of_a_row(precision: Precision) -> None:
    np.testing.assert_allclose(row_of(squashed, precision), np.tanh(B), rtol=1e-6 if precision == "float32" else 1e-15)


@pytest.mark.parametrize("without", [(), ("avx512f",), ("avx512f", "avx2")])
@pytest.mark.parametrize("precision", PRECISIONS)
def test_every_lane_looks_up_its_own_number(
    without: tuple[str, ...], precision: Precision, monkeypatch: pytest.MonkeyPatch, tmp_path: Any
) -> None:
    has = vectors._host_has
    monkeypatch.setattr(vectors, "_host_has", lambda feature: feature not in without and has(feature))
    source = compile_kernel_anew(taken, precision)
    table, places = RNG.normal(size=QUARTER), RNG.integers(0, QUARTER, LANES)
    y = np.zeros(LANES, dtype=precision)
    source(np.resize(table, LANES).astype(precision), places.astype(precision), y)
    np.testing.assert_array_equal(y, table[places].astype(precision))


def compile_kernel_anew(function: Callable[..., Any], precision: Precision) -> Any:
    """Compile without the folder of kernels, which knows nothing of other processors."""
    import numba

    from sysid_evo.engine.compiled.language import generate

    signature = Signature(a=REALS, b=REALS, y=REALS)
    text = generate(KernelSource(function), signature, precision, pointer=False).replace("cache=True, ", "")
    space: dict[str, Any] = {"numba": numba}
    exec(compile(text, "anew", "exec"), space)
    return space["entry"]


def test_every_word_of_the_kernel_language_has_a_compiled_meaning() -> None:
    assert [name for name in WORDS.values() if not hasattr(vectors, name)] == []
    assert all(getattr(kernels, name) is word for word, name in WORDS.items())


@pytest.mark.parametrize("function", [arithmetic, chosen, chosen_at_most, blended])
def test_a_word_means_for_each_lane_what_it_means_in_plain_python(function: Callable[..., Any]) -> None:
    with np.errstate(invalid="ignore"):
        rows = [np.zeros(1) for _ in range(LANES)]
        for lane, row in enumerate(rows):
            function(A[lane : lane + 1], B[lane : lane + 1], row)
        np.testing.assert_allclose(row_of(function, "float64"), np.concatenate(rows), rtol=1e-15)
