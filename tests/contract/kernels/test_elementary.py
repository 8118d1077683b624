"""The elementary functions of float32 kernels against the mathematics library in float64."""

import math

import numpy as np
import pytest

from sysid_evo.kernels import INTEGER, REALS, Signature
from tests.fixtures.lanes import compile_for_python

NAMES = ("tanh", "sin", "cos", "atan2")


def elementary(n, a, b, y):
    for i in range(n):
        y[i] = math.tanh(a[i])
        y[n + i] = math.sin(a[i])
        y[2 * n + i] = math.cos(a[i])
        y[3 * n + i] = math.atan2(a[i], b[i])


def evaluate(name, a, b=None):
    """Return the function ``name`` of ``a``, and ``b``, as float64."""
    given = [np.array(a if one is None else one, dtype=np.float32) for one in (a, b)]
    found = np.full((len(NAMES), len(given[0])), np.nan, dtype=np.float32)
    signature = Signature(n=INTEGER, a=REALS, b=REALS, y=REALS)
    compile_for_python(elementary, signature, "float32")(len(given[0]), *given, found.reshape(-1))
    return found[NAMES.index(name)].astype(np.float64)


def single(x):
    """The numbers that float32 can hold, as float64."""
    return x.astype(np.float32).astype(np.float64)


def test_tanh_is_good_to_its_stated_relative_error():
    x = single(np.concatenate([np.linspace(-12, 12, 400_001), np.geomspace(1e-20, 1, 10_001)]))
    x = x[x != 0]
    assert np.abs(evaluate("tanh", x) / np.tanh(x) - 1.0).max() < 4e-7


@pytest.mark.parametrize("name", ["sin", "cos"])
def test_sine_and_cosine_are_good_to_their_stated_error_up_to_1000(name):
    turns = np.arange(-600, 601) * (np.pi / 2)  # zeros and extremes, where a reduction goes wrong
    x = single(np.concatenate([np.linspace(-1000, 1000, 400_001), np.linspace(-4, 4, 100_001), turns]))
    assert np.abs(evaluate(name, x) - getattr(np, name)(x)).max() < 2e-7


def test_atan2_is_good_to_its_stated_error_in_every_direction_and_size():
    angle = np.linspace(-np.pi, np.pi, 200_001)
    for size in (1e-12, 1e-3, 1.0, 1e12):
        y, x = single(size * np.sin(angle)), single(size * np.cos(angle))
        off = evaluate("atan2", y, x) - np.arctan2(y, x)
        assert np.abs(off[np.abs(angle) < np.pi - 1e-6]).max() < 4e-7


def test_special_values_are_exact():
    assert evaluate("tanh", [0.0]) == evaluate("sin", [0.0]) == 0.0
    np.testing.assert_allclose(evaluate("tanh", [9.0, 50.0, -50.0, 1e30]), [1, 1, -1, 1], rtol=2e-7)
    np.testing.assert_allclose(evaluate("cos", [0.0]), [1.0], rtol=1e-7)
    y, x = np.array([0.0, 0.0, 1.0, -1.0, 1.0, 1.0, -1.0, -1.0, 0.0]), np.array([0, 1, 0, 0, 1, -1, 1, -1, -1.0])
    np.testing.assert_allclose(evaluate("atan2", y, x), np.arctan2(y, x), atol=3e-7)
    assert evaluate("atan2", np.zeros(2), [0.0, 2.0]).tolist() == [0.0, 0.0]


def test_functions_are_odd_or_even():
    x = np.random.default_rng(0).uniform(-20, 20, 1000)
    np.testing.assert_array_equal(evaluate("tanh", -x), -evaluate("tanh", x))
    np.testing.assert_array_equal(evaluate("sin", -x), -evaluate("sin", x))
    np.testing.assert_allclose(evaluate("cos", -x), evaluate("cos", x), atol=2e-7)


@pytest.mark.parametrize("name", ["tanh", "sin", "cos"])
def test_a_nan_stays_one(name):
    assert np.isnan(evaluate(name, [np.nan])).all()
