"""Forecasts: from cells of models alone, in the units of the task, with an interval that holds."""

from dataclasses import replace

import numpy as np
import pytest

from evaluation.transfer import Cell, Estimate, TransferMatrix
from evaluation.transfer.forecast import RULE, Rule, forecast_of, forecasts, model_forecasts, worth_by
from evaluation.transfer.summary import summary_of
from tests.fixtures.reports import evolved, matrix

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
    assert only.kept is not None
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
