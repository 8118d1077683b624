"""Error measures against numbers worked out by hand."""

import numpy as np
import pytest

from sysid_evo.errors import ShapeError
from sysid_evo.validation import measures

TRUE = np.array([[1.0], [3.0]])
SWAPPED = np.array([[2.0], [2.0]])
SHIFTED = np.array([[3.0], [5.0]])


@pytest.mark.parametrize(
    ("measure", "predicted", "given", "expected"),
    [
        ("rmse", SWAPPED, {}, 1.0),
        ("rmse", SHIFTED, {}, 2.0),
        ("error_std", SHIFTED, {}, 0.0),  # a constant error has none
        ("error_std", SWAPPED, {}, 1.0),
        ("relative_percent", SWAPPED, {}, 100.0 / np.sqrt(5.0)),  # of the rms of the signal
        ("relative_percent", SWAPPED, {"rms": [4.0]}, 25.0),
        ("nrmse", SWAPPED, {}, 1.0),  # of the standard deviation of the truth
        ("nrmse", SHIFTED, {"std": [8.0]}, 0.25),
        ("fit_percent", SWAPPED, {}, 0.0),  # as predicting the mean does
        ("fit_percent", TRUE, {}, 100.0),
    ],
)
def test_a_measure_is_what_is_worked_out_by_hand(measure, predicted, given, expected):
    assert getattr(measures, measure)(TRUE, predicted, **given) == pytest.approx([expected])


def test_a_constant_channel_has_no_nrmse_and_is_left_out_of_the_mean():
    true, predicted = np.array([[1.0, 5.0], [3.0, 5.0]]), np.array([[2.0, 6.0], [2.0, 6.0]])
    each = measures.nrmse(true, predicted)
    assert np.isnan(each[1])
    assert measures.mean_over_channels(each) == pytest.approx(1.0)


def test_windows_and_plain_rows_give_the_same_error(rng):
    true, predicted = rng.normal(size=(2, 4, 5, 3))
    assert measures.rmse(true, predicted) == pytest.approx(measures.rmse(true.reshape(-1, 3), predicted.reshape(-1, 3)))


def test_shapes_that_differ_are_refused():
    with pytest.raises(ShapeError, match=r"expected shape \(2, 1\).*got \(3, 1\)"):
        measures.rmse(TRUE, np.zeros((3, 1)))
