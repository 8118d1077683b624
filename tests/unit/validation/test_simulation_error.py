"""Error measures against numbers worked out by hand."""

import numpy as np
import pytest

from sysid_evo.errors import ShapeError
from sysid_evo.validation import measures

TRUE = np.array([[1.0], [3.0]])
SWAPPED = np.array([[2.0], [2.0]])
SHIFTED = np.array([[3.0], [5.0]])


def test_rmse_is_the_root_of_the_mean_square():
    assert measures.rmse(TRUE, SWAPPED) == pytest.approx([1.0])
    assert measures.rmse(TRUE, SHIFTED) == pytest.approx([2.0])


def test_a_constant_error_has_no_standard_deviation():
    assert measures.error_std(TRUE, SHIFTED) == pytest.approx([0.0])
    assert measures.error_std(TRUE, SWAPPED) == pytest.approx([1.0])


def test_relative_error_is_of_the_rms_of_the_signal():
    assert measures.relative_percent(TRUE, SWAPPED) == pytest.approx([100.0 / np.sqrt(5.0)])
    assert measures.relative_percent(TRUE, SWAPPED, rms=[4.0]) == pytest.approx([25.0])


def test_nrmse_is_of_the_standard_deviation_of_the_truth():
    assert measures.nrmse(TRUE, SWAPPED) == pytest.approx([1.0])
    assert measures.nrmse(TRUE, SHIFTED, std=[8.0]) == pytest.approx([0.25])


def test_predicting_the_mean_fits_zero_per_cent_and_the_truth_a_hundred():
    assert measures.fit_percent(TRUE, SWAPPED) == pytest.approx([0.0])
    assert measures.fit_percent(TRUE, TRUE) == pytest.approx([100.0])


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
