"""Rows as values and where arrays lie: every operation on 64 lanes is what NumPy does, in both precisions."""

import math

import numba
import numpy as np
import pytest

from sysid_evo import kernels
from sysid_evo.engine.compiled import vectors
from sysid_evo.engine.compiled.compiler import compile_kernel
from sysid_evo.engine.compiled.language import generate
from sysid_evo.engine.compiled.workspace import CACHE_LINE, SMALL, aligned, empty_lines, together
from sysid_evo.kernels import (
    INTEGERS,
    LANES,
    QUARTER,
    REALS,
    WORDS,
    KernelSource,
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
from tests.fixtures.lanes import PRECISIONS

RNG = np.random.default_rng(3)
A, B = RNG.normal(size=LANES), RNG.normal(size=LANES)
A[:4] = B[:4]  # equal ones
A[4], B[5] = np.nan, np.nan
A[6] = np.inf
ROWS, BITS = Signature(a=REALS, b=REALS, y=REALS), Signature(a=REALS, b=REALS, y=INTEGERS)


def rows(a, b, y):
    store(y, 0, (2.0 * load(a, 0) - load(b, 0)) / 4.0 + -(load(a, 0) * load(b, 0)) + abs(load(b, 0)) * 0.5 - 1.0)
    store(y, LANES, where_less(load(a, 0), load(b, 0), 1.0, load(b, 0)))
    store(y, 2 * LANES, where_at_most(load(a, 0), load(b, 0), splat(2.0), 0.0))
    store(y, 3 * LANES, where_bits(lanes_at_most(load(a, 0), load(b, 0)), load(a, 0), load(b, 0)))
    store(y, 4 * LANES, min(max(load(a, 0), -0.5), 0.5))
    store(y, 5 * LANES, min(load(a, 0), load(b, 0)))
    store(y, 6 * LANES, max(load(a, 0), load(b, 0)))
    store(y, 7 * LANES, math.tanh(load(b, 0)))


def bits(a, b, y):
    y[0] = lanes_differ(load(a, 0), load(b, 0))
    y[1] = lanes_less(load(a, 0), load(b, 0))
    y[2] = lanes_at_most(load(a, 0), load(b, 0))
    y[3] = lanes_at_most(load_quarter(a, 0), load_quarter(b, 0))
    y[4] = first_lane(lanes_less(load(a, 0), load(b, 0)) & (1 << 63))


def taken(a, b, y):
    for first in range(0, LANES, QUARTER):
        store(y, first, look_up(load_quarter(a, 0), load_quarter(b, first)))


def rows_of(precision):
    y = np.zeros(8 * LANES, dtype=precision)
    compile_kernel(KernelSource(rows), ROWS, precision, pointer=False)(A.astype(precision), B.astype(precision), y)
    return y.reshape(8, LANES)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_rows_are_computed_compared_and_chosen_as_by_numpy(precision):
    found, known = rows_of(precision), np.isfinite(A) & np.isfinite(B)
    with np.errstate(invalid="ignore"):
        expected = (2.0 * A - B) / 4.0 - A * B + np.abs(B) * 0.5 - 1.0
    np.testing.assert_allclose(found[0], expected, rtol=1e-5)
    a, b = A.astype(precision), B.astype(precision)
    np.testing.assert_array_equal(found[1], np.where(a < b, 1.0, b))  # the second where nothing compares
    np.testing.assert_array_equal(found[2], np.where(a <= b, 2.0, 0.0))
    np.testing.assert_array_equal(found[3], np.where(a <= b, a, b))
    np.testing.assert_array_equal(found[4], np.clip(a, -0.5, 0.5))
    np.testing.assert_array_equal(found[5][known], np.minimum(a, b)[known])
    np.testing.assert_array_equal(found[6][known], np.maximum(a, b)[known])
    np.testing.assert_allclose(found[7], np.tanh(B), rtol=1e-6 if precision == "float32" else 1e-15)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_comparisons_are_bits_and_what_is_no_number_only_differs(precision):
    compiled, y = compile_kernel(KernelSource(bits), BITS, precision, pointer=False), np.zeros(5, dtype=np.int64)
    a, b = A.astype(precision), B.astype(precision)
    compiled(a, b, y)
    found = (y.view(np.uint64)[:, None] >> np.arange(LANES, dtype=np.uint64)) & np.uint64(1) == 1
    quarter = (a <= b) & (np.arange(LANES) < QUARTER)
    for lanes, expected in zip(found, (a != b, a < b, a <= b, quarter), strict=False):
        np.testing.assert_array_equal(lanes, expected)
    compiled(np.zeros(LANES, precision), np.ones(LANES, precision), y)
    assert y[4] == LANES - 1, "the last lane has a bit as well"


def test_a_word_means_for_each_lane_what_it_means_in_plain_python():
    with np.errstate(invalid="ignore"):
        plain = np.zeros((LANES, 8 * LANES))
        for lane, row in enumerate(plain):
            rows(A[lane : lane + 1], B[lane : lane + 1], row)
        np.testing.assert_allclose(rows_of("float64")[:4], plain[:, : 4 * LANES : LANES].T, rtol=1e-15)


@pytest.mark.parametrize("without", [(), ("avx512f",), ("avx512f", "avx2")])
@pytest.mark.parametrize("precision", ["float32", pytest.param("float64", marks=pytest.mark.nightly)])
def test_every_lane_looks_up_its_own_number(without, precision, monkeypatch):
    """Compiled without the folder of kernels, which knows nothing of other processors."""
    has = vectors._host_has
    monkeypatch.setattr(vectors, "_host_has", lambda feature: feature not in without and has(feature))
    text, space = generate(KernelSource(taken), ROWS, precision, pointer=False), {"numba": numba}
    exec(compile(text.replace("cache=True, ", ""), "anew", "exec"), space)
    table, places = RNG.normal(size=QUARTER), RNG.integers(0, QUARTER, LANES)
    y = np.zeros(LANES, dtype=precision)
    space["entry"](np.resize(table, LANES).astype(precision), places.astype(precision), y)
    np.testing.assert_array_equal(y, table[places].astype(precision))


def test_every_word_of_the_kernel_language_has_a_compiled_meaning():
    assert [name for name in WORDS.values() if not hasattr(vectors, name)] == []
    assert all(getattr(kernels, name) is word for word, name in WORDS.items())


def begin(array):
    return int(array.__array_interface__["data"][0])


@pytest.mark.parametrize("precision", PRECISIONS)
def test_zeros_and_copies_begin_on_a_cache_line(precision):
    assert begin(empty_lines(3, precision)) % CACHE_LINE == 0
    copied = aligned(np.arange(6.0).reshape(2, 3), precision)
    assert begin(copied) % CACHE_LINE == 0
    assert copied.dtype == precision
    assert copied.tolist() == [0, 1, 2, 3, 4, 5]


def test_there_is_always_one_number_to_point_at():
    assert len(empty_lines(0, "float32")) == 1
    assert len(together({"none": 0}, "float32")["none"]) == 1


@pytest.mark.parametrize("precision", PRECISIONS)
def test_what_is_used_together_lies_one_after_the_other(precision):
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
    found["small"][:] = 2.0
    assert small.tolist() == [0, 1, 2, 3, 4], "a copy is a copy"
