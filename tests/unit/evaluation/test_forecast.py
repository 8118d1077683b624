"""Credibility: how much each model counts, and the median that follows."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from evaluation.cells.data import GivenData, Split
from evaluation.cells.models import PredictCell
from evaluation.cells.plants import Plant, believed
from evaluation.prediction import ErrorScore, Interval, ModelPrediction
from evaluation.transfer import Cell, Estimate, TransferMatrix
from evaluation.transfer.forecast import (
    RULE,
    Rule,
    credibilities,
    forecast_of,
    forecasts,
    model_forecasts,
    weighted_median,
    worth_by,
)
from evaluation.transfer.summary import summary_of
from sysid_evo.plan import Work
from sysid_evo.testing import example_dataset
from tests.fixtures.reports import evolved, matrix

NONE_OWN = np.zeros(2, dtype=bool)
HALF_OWN = Rule(power=2.0, own=0.5)


def test_a_model_with_twice_the_error_counts_a_quarter():
    np.testing.assert_allclose(credibilities([0.1, 0.2], NONE_OWN, rule=HALF_OWN), [0.8, 0.2])


def test_a_model_of_the_controllers_own_family_counts_half():
    np.testing.assert_allclose(credibilities([0.1, 0.1], np.array([True, False]), rule=HALF_OWN), [1 / 3, 2 / 3])


def test_a_model_whose_error_is_not_known_counts_as_much_as_the_best():
    weights = credibilities([0.1, None, 0.2], np.zeros(3, dtype=bool), rule=HALF_OWN)
    assert weights[0] == weights[1] == pytest.approx(4 * weights[2])


def test_without_any_error_all_count_alike():
    np.testing.assert_array_equal(credibilities([None, None], NONE_OWN, rule=HALF_OWN), [0.5, 0.5])


def test_a_model_whose_error_is_no_number_does_not_count():
    np.testing.assert_array_equal(credibilities([float("inf"), 0.1], NONE_OWN, rule=HALF_OWN), [0.0, 1.0])
    np.testing.assert_array_equal(credibilities([float("nan"), float("inf")], NONE_OWN, rule=HALF_OWN), [0.5, 0.5])


def test_errors_next_to_nothing_are_told_apart_no_more():
    np.testing.assert_array_equal(credibilities([0.0, 1e-9], NONE_OWN, rule=HALF_OWN), [0.5, 0.5])


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


ERRORS = {"good": 0.1, "fair": 0.2, "poor": 1.0}
CLAIMS = {"poor": {"good": 6.0, "fair": 7.0, "poor": 20.0}, "good": {"good": 9.0, "fair": 8.0, "poor": 4.0}}


def test_what_the_models_say_that_predict_is_what_is_forecast():
    found = forecasts(matrix(CLAIMS), ERRORS)
    assert found["poor"].value == pytest.approx(6.0, abs=0.3)
    assert found["poor"].low < found["poor"].value < found["poor"].high < 8.0
    assert found["poor"].weights["good"] > 0.7 > 0.3 > found["poor"].weights["fair"]
    assert sum(found["poor"].weights.values()) == pytest.approx(1.0)


def test_nothing_that_was_measured_on_a_robot_enters():
    rows = {
        name: {**columns, "car": fitness} for (name, columns), fitness in zip(CLAIMS.items(), (1.0, 30.0), strict=True)
    }
    assert forecasts(matrix(rows, robot="car"), ERRORS) == forecasts(matrix(CLAIMS), ERRORS)
    other = replace(matrix(rows, robot="car"), robot=None, other_robots=("car",))
    assert forecasts(other, ERRORS) == forecasts(matrix(CLAIMS), ERRORS)


def test_what_was_evolved_on_the_robot_itself_has_no_forecast():
    rows = {"good": {"good": 9.0, "fair": 8.0, "car": 5.0}, "car": {"good": 5.0, "fair": 5.0, "car": 12.0}}
    assert set(forecasts(matrix(rows, robot="car"), ERRORS)) == {"good"}


def test_one_model_alone_is_too_few():
    assert forecasts(matrix({"good": {"good": 9.0}}), ERRORS) == {}
    assert forecasts(matrix({"good": {"good": 9.0, "fair": float("nan")}}), ERRORS) == {}


def test_a_forecast_is_in_the_units_of_the_task_and_moves_with_its_zero():
    rng = np.random.default_rng(0)
    trials = [rng.normal(mean, 1.0, size=50) for mean in (10.0, 9.0, 12.0)]
    plain = np.array(forecast_of(trials, [0.1, 0.2, 0.3], [False, True, False]))
    scaled = np.array(forecast_of([5.0 * one - 300.0 for one in trials], [0.1, 0.2, 0.3], [False, True, False]))
    np.testing.assert_allclose(scaled, 5.0 * plain - 300.0)


def test_the_interval_is_wider_where_models_differ_and_narrower_where_more_agree():
    def width(*means):
        trials = [mean + np.tile([-1.0, 1.0], 10) for mean in means]
        _, low, high = forecast_of(trials, [0.1] * len(means), [False] * len(means))
        return high - low

    assert width(8.0, 10.0, 12.0) > 2.0 * width(9.9, 10.0, 10.1)
    assert width(10.0, 10.0, 10.0, 10.0) == pytest.approx(width(10.0, 10.0))  # all meet the same trials


def test_models_share_errors_so_the_interval_falls_with_the_fourth_root_of_their_number():
    def width(*means):
        _, low, high = forecast_of([np.full(3, mean) for mean in means], [0.1] * len(means), [False] * len(means))
        return high - low

    assert width(9.0, 9.0, 11.0, 11.0) == pytest.approx(width(9.0, 11.0) / 2.0**0.25)


def test_the_interval_falls_with_the_root_of_the_number_of_trials():
    def width(each):
        _, low, high = forecast_of([np.array([9.0, 11.0] * each)] * 2, [0.1] * 2, [False] * 2)
        return high - low

    assert width(1) == pytest.approx((RULE.high - RULE.low) / np.sqrt(2.0))
    assert width(4) == pytest.approx(width(1) / 2.0)


def test_a_forecast_by_another_rule_believes_models_by_that_rule():
    trials = [np.full(2, mean) for mean in (8.0, 10.0, 12.0)]
    low, high = (
        forecast_of(trials, [0.1, 0.2, 0.3], [False, False, True], rule=Rule(power=power))[0] for power in (9.0, 0.0)
    )
    assert low < 8.2 < 9.0 < high


def test_nine_in_ten_intervals_hold_where_what_is_missed_is_as_in_calibration():
    rng, missed = np.random.default_rng(1), []
    for _ in range(2000):
        truth = rng.normal(10.0, 3.0)
        means = truth + rng.normal(0.0, 1.0, size=4)
        value, low, high = forecast_of(
            [np.full(2, mean) for mean in means], [0.1] * 4, [False] * 4, rule=Rule(low=-1.0, high=1.0)
        )
        missed.append((truth - value) / (high - value))
    low, high = np.quantile(missed, [0.05, 0.95])
    fresh, held = np.random.default_rng(2), 0
    for _ in range(2000):
        truth = fresh.normal(10.0, 3.0)
        trials = [np.full(2, mean) for mean in truth + fresh.normal(0.0, 1.0, size=4)]
        _, lowest, highest = forecast_of(trials, [0.1] * 4, [False] * 4, rule=Rule(low=low, high=high))
        held += lowest <= truth <= highest
    assert 0.88 < held / 2000 < 0.92


def test_what_is_achieved_is_held_against_the_interval_and_its_own_error():
    found = forecasts(matrix(CLAIMS), ERRORS)["good"]
    outside = found.low - 0.3 * (found.value - found.low)
    assert found.holds(Estimate(found.value, 0.0))
    assert not found.holds(Estimate(outside, 0.01))
    assert found.holds(Estimate(outside, found.value - found.low))
    assert not found.holds(Estimate(outside, float("nan")))


def test_the_trials_of_a_controller_become_one_by_the_rule_of_its_evolution():
    cells = [Cell("c", column, np.array([1.0, 2.0, 30.0]), unit="m") for column in ("a", "b")]
    champion = replace(evolved("c", ("a",)), aggregate="cvar(share=0.3)")
    made = TransferMatrix.of([champion], ("a", "b"), cells)
    assert (
        forecasts(made, {})["c"].value
        < 2.0
        < forecasts(replace(made, champions=(evolved("c", ("a",)),)), {})["c"].value
    )


def test_a_model_is_forecast_by_the_controllers_that_were_evolved_in_it_alone():
    rows = {"poor": CLAIMS["poor"], "both": {"good": 9.0, "fair": 9.0, "poor": 9.0}}
    made = matrix(rows, against={"both": ("good", "fair")})
    found = forecasts(made, ERRORS)
    (only,) = model_forecasts(made, found).values()
    assert (only.model, only.controllers, only.claimed) == ("poor", ("poor",), 20.0)
    assert (only.value, only.low, only.high) == (found["poor"].value, found["poor"].low, found["poor"].high)
    assert only.kept[0] == pytest.approx(found["poor"].value / 20.0)


def test_where_nothing_is_claimed_no_share_of_it_is_kept():
    made = matrix({"good": {"good": -3.0, "fair": -4.0}})
    assert model_forecasts(made, forecasts(made, ERRORS))["good"].kept is None


def test_finalists_are_ranked_by_the_same_number():
    worth = worth_by(ERRORS, {name: name for name in ERRORS})
    by_model = np.array([[6.0, 9.0], [7.0, 8.0], [20.0, 4.0]])
    ranked = worth(evolved("poor", ("poor",)), ("good", "fair", "poor"), by_model)
    assert ranked[0] == pytest.approx(forecasts(matrix(CLAIMS), ERRORS)["poor"].value)


def test_what_was_written_by_hand_is_not_chosen_however_high_its_forecast():
    rows = {"good": CLAIMS["good"], "hand": {"good": 30.0, "fair": 30.0, "poor": 30.0}}
    made = matrix(rows, against={"hand": ()})
    found = forecasts(made, ERRORS)
    assert found["hand"].value > found["good"].value
    assert summary_of(made, ERRORS).pick == "good"


DATA = GivenData(example_dataset(), Split())
MEASURED = {}


def column(label, family, errors=None):
    MEASURED[label] = errors
    return Plant(label, family, prediction=PredictCell(label, family, DATA))


def measured(cell):
    errors = MEASURED[cell.label]
    if errors is None:
        return None
    kinds = ("rmse", "error_std", "relative_percent", "nrmse")
    scores = (
        ErrorScore(
            horizon, 10, interval=Interval(n, n), resampled_n=np.array([n]), **{kind: np.full(3, n) for kind in kinds}
        )
        for horizon, n in errors.items()
    )
    return ModelPrediction(cell.label, cell.family, tuple(scores))


def no_progress(done, total, note=""):
    pass


def nowhere(cell):
    raise AssertionError(f"nobody asks where {cell.title} stands")


def names(*columns):
    work = Work(measured, no_progress, Path("unused"), Path("unused"), nowhere)
    return tuple(one.label for one in believed(columns, work))


def test_a_model_is_believed_whose_error_at_one_second_is_near_that_of_the_best():
    good, near, far = (column(f"{n}", f"{n}", {1: 1.0 - n, 20: n, 60: 1.0}) for n in (0.10, 0.149, 0.151))
    assert names(far, near, good) == ("0.149", "0.1")


def test_where_it_was_not_measured_at_one_second_the_longest_horizon_counts():
    assert names(
        column("a", "a", {1: 0.9, 10: 0.1}), column("b", "b", {1: 0.1, 10: 0.1}), column("c", "c", {10: 0.9})
    ) == (
        "a",
        "b",
    )


def test_the_best_of_two_families_are_believed_so_that_one_can_judge_the_other():
    first, again = column("first", "narx", {20: 0.1}), column("again", "narx", {20: 0.12})
    second, third = column("second", "linear", {20: 0.4}), column("third", "sindy", {20: 0.5})
    assert names(first, again, second, third) == ("first", "again", "second")


def test_a_robot_and_what_was_not_measured_are_believed():
    robot, failed = Plant("car", "car"), column("failed", "failed")
    assert names(robot, failed) == ("car", "failed")
    assert names(
        robot, failed, column("a", "a", {20: 0.1}), column("b", "b", {20: 0.2}), column("c", "c", {20: 0.3})
    ) == (
        "car",
        "failed",
        "a",
        "b",
    )
