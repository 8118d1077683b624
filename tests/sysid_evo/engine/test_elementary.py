"""The elementary functions of float32 kernels against the mathematics library in float64."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from sysid_evo.kernels import NUMBER, REALS, Signature
from sysid_evo.types import Array
from tests.sysid_evo.engine.running import compile_for_python

ONE = Signature(n=NUMBER, x=REALS, y=REALS)
TWO = Signature(n=NUMBER, a=REALS, b=REALS, y=REALS)


def tanh(n, x, y):
    for i in range(n):
        y[i] = math.tanh(x[i])


def sin(n, x, y):
    for i in range(n):
        y[i] = math.sin(x[i])


def cos(n, x, y):
    for i in range(n):
        y[i] = math.cos(x[i])


def atan2(n, a, b, y):
    for i in range(n):
        y[i] = math.atan2(a[i], b[i])


def evaluate(function: Callable[..., Any], *arguments: Array) -> Array:
    given = [np.array(a, dtype=np.float32) for a in arguments]
    result = np.full_like(given[0], np.nan)
    compile_for_python(function, ONE if len(given) == 1 else TWO, "float32")(len(result), *given, result)
    return result.astype(np.float64)


def single(x: Array) -> Array:
    """The numbers that float32 can hold, as float64."""
    return x.astype(np.float32).astype(np.float64)


def test_tanh_is_good_to_its_stated_relative_error() -> None:
    x = single(np.concatenate([np.linspace(-12, 12, 400_001), np.geomspace(1e-20, 1, 10_001)]))
    x = x[x != 0]
    assert np.abs(evaluate(tanh, x) / np.tanh(x) - 1.0).max() < 4e-7


@pytest.mark.parametrize("function, exact", [(sin, np.sin), (cos, np.cos)])
def test_sine_and_cosine_are_good_to_their_stated_error_up_to_1000(function: Any, exact: Any) -> None:
    turns = np.arange(-600, 601) * (np.pi / 2)  # zeros and extremes, where a reduction goes wrong
    x = single(np.concatenate([np.linspace(-1000, 1000, 400_001), np.linspace(-4, 4, 100_001), turns]))
    assert np.abs(evaluate(function, x) - exact(x)).max() < 2e-7


def test_atan2_is_good_to_its_stated_error_in_every_direction_and_size() -> None:
    angle = np.linspace(-np.pi, np.pi, 200_001)
    for size in (1e-12, 1e-3, 1.0, 1e12):
        y, x = single(size * np.sin(angle)), single(size * np.cos(angle))
        off = evaluate(atan2, y, x) - np.arctan2(y, x)
        off = off[np.abs(angle) < np.pi - 1e-6]
        assert np.abs(off).max() < 4e-7


def test_special_values_are_exact() -> None:
    np.testing.assert_array_equal(evaluate(tanh, np.array([0.0])), [0.0])
    np.testing.assert_allclose(evaluate(tanh, np.array([9.0, 50.0, -50.0, 1e30])), [1, 1, -1, 1], rtol=2e-7)
    np.testing.assert_array_equal(evaluate(sin, np.array([0.0])), [0.0])
    np.testing.assert_allclose(evaluate(cos, np.array([0.0])), [1.0], rtol=1e-7)
    y, x = np.array([0.0, 0.0, 1.0, -1.0, 1.0, 1.0, -1.0, -1.0, 0.0]), np.array([0, 1, 0, 0, 1, -1, 1, -1, -1.0])
    np.testing.assert_allclose(evaluate(atan2, y, x), np.arctan2(y, x), atol=3e-7)
    assert evaluate(atan2, np.zeros(2), np.array([0.0, 2.0])).tolist() == [0.0, 0.0]


def test_functions_are_odd_or_even() -> None:
    x = np.random.default_rng(0).uniform(-20, 20, 1000)
    np.testing.assert_array_equal(evaluate(tanh, -x), -evaluate(tanh, x))
    np.testing.assert_array_equal(evaluate(sin, -x), -evaluate(sin, x))
    np.testing.assert_allclose(evaluate(cos, -x), evaluate(cos, x), atol=2e-7)


def test_a_nan_stays_one() -> None:
    bad = np.array([np.nan])
    for function in (tanh, sin, cos):
        assert np.isnan(evaluate(function, bad)).all()
