"""The checks that name an array, what was expected of it, and what came."""

import numpy as np
import pytest

from sysid_evo.errors import ShapeError
from sysid_evo.types import check_last, check_shape


def test_an_array_of_the_right_shape_comes_back_as_float64_without_a_copy():
    array = np.zeros((3, 2))
    assert check_shape("x", array, (None, 2)) is array
    assert check_last("x", array, 2) is array
    assert check_shape("x", [[1, 2]], (1, 2)).dtype == np.float64


def test_a_wrong_shape_is_named_with_both_sides():
    with pytest.raises(ShapeError, match=r"poses: expected shape \(any, 2\), got \(3, 4\)"):
        check_shape("poses", np.zeros((3, 4)), (None, 2))
    with pytest.raises(ShapeError, match=r"poses: expected shape \(any, 2\), got \(2,\)"):
        check_shape("poses", np.zeros(2), (None, 2))
    with pytest.raises(ShapeError, match=r"raw: expected 2 values on the last axis, got shape \(\)"):
        check_last("raw", 1.0, 2)


@pytest.mark.parametrize("value", ["text", [[1.0], [1.0, 2.0]], [object()]])
def test_what_is_no_array_of_numbers_is_named(value):
    for check in (lambda: check_shape("poses", value, (None,)), lambda: check_last("poses", value, 1)):
        with pytest.raises(ShapeError, match=r"poses: expected numbers, got (str|list)"):
            check()
