"""Credibility: how much each model counts, and the median that follows."""

import numpy as np
import pytest

from evaluation.transfer.forecast import Rule, credibilities, weighted_median

NONE_OWN = np.zeros(2, dtype=bool)
RULE = Rule(power=2.0, own=0.5)


def test_a_model_with_twice_the_error_counts_a_quarter():
    np.testing.assert_allclose(credibilities([0.1, 0.2], NONE_OWN, rule=RULE), [0.8, 0.2])


def test_a_model_of_the_controllers_own_family_counts_half():
    np.testing.assert_allclose(credibilities([0.1, 0.1], np.array([True, False]), rule=RULE), [1 / 3, 2 / 3])


def test_a_model_whose_error_is_not_known_counts_as_much_as_the_best():
    weights = credibilities([0.1, None, 0.2], np.zeros(3, dtype=bool), rule=RULE)
    assert weights[0] == weights[1] == pytest.approx(4 * weights[2])


def test_without_any_error_all_count_alike():
    np.testing.assert_array_equal(credibilities([None, None], NONE_OWN, rule=RULE), [0.5, 0.5])


def test_a_model_whose_error_is_no_number_does_not_count():
    np.testing.assert_array_equal(credibilities([float("inf"), 0.1], NONE_OWN, rule=RULE), [0.0, 1.0])
    np.testing.assert_array_equal(credibilities([float("nan"), float("inf")], NONE_OWN, rule=RULE), [0.5, 0.5])


def test_errors_next_to_nothing_are_told_apart_no_more():
    np.testing.assert_array_equal(credibilities([0.0, 1e-9], NONE_OWN, rule=RULE), [0.5, 0.5])


def test_of_equal_weights_the_median_is_the_usual_one():
    values = np.random.default_rng(0).normal(size=(7, 4))
    for count in (6, 7):
        weights = np.full(count, 1.0 / count)
        np.testing.assert_allclose(weighted_median(values[:count], weights), np.median(values[:count], axis=0))


def test_a_weight_of_two_is_a_value_that_stands_there_twice_where_one_lies_in_the_middle():
    values, weights = np.array([3.0, 1.0, 2.0]), np.array([1.0, 1.0, 2.0])
    assert weighted_median(values, weights) == 2.0


def test_a_wild_value_of_little_weight_changes_little():
    weights = np.array([0.45, 0.45, 0.1])
    tame, wild = (float(weighted_median(np.array([9.0, 10.0, last]), weights)) for last in (8.0, -1000.0))
    assert wild == tame == pytest.approx(9.4, abs=0.1)
