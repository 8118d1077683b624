"""A function of plain numbers means the same for arrays."""

from __future__ import annotations

import math
from math import atan2, sin

import numpy as np
import pytest

from sysid_evo.errors import InvalidArgument
from sysid_evo.laws import array_form

SHARE = 0.25


def positive(value):
    return value if value > 0.0 else 0.0


def everything(x, y):
    inside = (0.0 < x < 1.0 and not y > 0.5) or y < -1.0
    total = SHARE if inside else positive(x) + math.exp(-abs(y))
    for i in range(2):
        total += min(x, y, 0.3) * max(x, float(i)) + sin(y) * atan2(y, x + 5.0)
    return total, math.copysign(math.pi, y)


def test_every_construct_gives_the_same_number_for_number() -> None:
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-2.0, 2.0, (2, 200))
    for found, row in zip(np.array(array_form(everything)(x, y)).T, zip(x, y, strict=True), strict=True):
        np.testing.assert_allclose(found, everything(*map(float, row)), rtol=1e-12)


def branching(x):
    if x > 0.0:
        return x
    return 0.0


def test_a_statement_that_would_choose_for_all_rows_is_refused_with_what_to_write() -> None:
    with pytest.raises(InvalidArgument, match=r"function branching, line 2 of it: 'if'.*'a if test else b'"):
        array_form(branching)
