"""Credibility: how much each model counts, and the median that follows."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from evaluation.cells.data import GivenData, HoldOut
from evaluation.cells.models import Predict
from evaluation.cells.plants import Plant, accurate_plants
from evaluation.prediction.scores import ErrorScore, ModelPrediction, forecast_error
from evaluation.transfer.forecast import (
    FORECAST_RULE,
    ForecastRule,
    best_choice,
    forecast_judgement,
    forecast_of,
    forecasts,
    model_forecasts,
    model_weights,
    weighted_median,
)
from evaluation.transfer.matrix import TransferMatrix
from evaluation.transfer.matrix import TransferResult as Cell
from sysid_evo.plan import CellContext
from sysid_evo.testing import example_dataset
from sysid_evo.validation.estimates import Draws, Estimate
from tests.fixtures.reports import evolved, matrix, prediction, report

INF, NAN = float("inf"), float("nan")


@pytest.mark.parametrize(
    ("errors", "own", "weights"),
    [
        ([0.1, 0.2], [], [0.8, 0.2]),
        ([0.1, 0.1], [0], [1 / 3, 2 / 3]),
        ([0.1, None, 0.2], [], [4 / 9, 4 / 9, 1 / 9]),
        ([None, None], [], [0.5, 0.5]),
        ([INF, 0.1], [], [0.0, 1.0]),
        ([NAN, INF], [], [0.5, 0.5]),
        ([0.0, 0.1], [], [0.5, 0.5]),
        ([0.2, 0.4], [], [0.8, 0.2]),
    ],
    ids=[
        "twice the error, a quarter", "of the own family, half", "not known, as much as the best", "none known",
        "no number, nothing", "no number anywhere", "next to nothing, no more told apart", "above that",
    ],
)  # fmt: skip
def test_models_count_by_their_errors(errors, own, weights):
    is_own = np.isin(np.arange(len(errors)), own)
    np.testing.assert_allclose(
        model_weights(errors, is_own, rule=ForecastRule(power=2.0, own=0.5)), weights, rtol=1e-12
    )


def test_of_equal_weights_the_median_is_the_usual_one():
    values = np.random.default_rng(0).normal(size=(7, 4))
    for count in (6, 7):
        weights = np.full(count, 1.0 / count)
        np.testing.assert_allclose(weighted_median(values[:count], weights), np.median(values[:count], axis=0))


def test_a_weight_of_two_equals_a_repeated_value_if_one_is_in_the_middle():
    values, weights = np.array([3.0, 1.0, 2.0]), np.array([1.0, 1.0, 2.0])
    assert weighted_median(values, weights) == 2.0


def test_a_wild_value_of_little_weight_changes_little():
    weights = np.array([0.45, 0.45, 0.1])
    tame, wild = (float(weighted_median(np.array([9.0, 10.0, last]), weights)) for last in (8.0, -1000.0))
    assert wild == tame == pytest.approx(9.4, abs=0.1)


ERRORS = {"good": 0.1, "fair": 0.2, "poor": 1.0}
CLAIMS = {"poor": {"good": 6.0, "fair": 7.0, "poor": 20.0}, "good": {"good": 9.0, "fair": 8.0, "poor": 4.0}}


def test_the_forecast_follows_the_models_that_predict():
    found = forecasts(matrix(CLAIMS), ERRORS)
    assert found["poor"].value == pytest.approx(6.0, abs=0.3)
    assert found["poor"].low < found["poor"].value < found["poor"].high < 8.0
    assert found["poor"].weights["good"] > 0.7 > 0.3 > found["poor"].weights["fair"]
    assert sum(found["poor"].weights.values()) == pytest.approx(1.0)
    own = {"good": 0.5, "fair": 0.25, "poor": 0.01}  # evolved in the best one, which counts half
    assert found["good"].weights == pytest.approx({name: weight / 0.76 for name, weight in own.items()})


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


def test_a_model_that_fails_the_sanity_check_has_no_weight_and_does_not_move_the_median():
    failed = ModelPrediction("poor", "poor", (score(20, 0.1),), warning="poor is worse than no change")
    assert forecast_error(failed) == INF
    assert forecast_error(replace(failed, warning="")) == pytest.approx(0.1)
    assert forecast_error(None) is None
    errors = {**ERRORS, "poor": forecast_error(failed)}
    rows = {name: {"good": 9.0, "poor": 8.5, "fair": 8.0} for name in ("good", "poor")}
    found, without = forecasts(matrix(rows), errors)["good"], {**rows["good"]}
    del without["poor"]
    alone = forecasts(matrix({"good": without}), ERRORS)["good"]
    assert found.weights["poor"] == 0.0
    assert (found.value, found.low, found.high) == (alone.value, alone.low, alone.high)
    one_left = forecasts(matrix(rows), {**errors, "fair": INF})["good"]  # the others count as the mean of the data
    assert one_left == forecasts(matrix(rows), {"good": 0.1, "poor": 1.0, "fair": 1.0})["good"]
    worth = forecast_judgement(errors, {name: name for name in ERRORS})
    by_model = np.array([[9.0], [8.5], [8.0]])
    assert worth(evolved("good", ("good",)), ("good", "poor", "fair"), by_model) == found.value
    two, known = ("good", "poor"), forecast_judgement({**errors, "poor": 1.0}, {name: name for name in ERRORS})
    assert worth(evolved("good", two[:1]), two, by_model[:2]) == known(evolved("good", two[:1]), two, by_model[:2])
    none_left = forecasts(matrix(rows), dict.fromkeys(errors, INF))
    assert none_left == forecasts(matrix(rows), dict.fromkeys(errors, 1.0))
    predicted = prediction(dict.fromkeys(ERRORS, 0.1))
    models = tuple(replace(one, warning="poor" if one.name == "poor" else "") for one in predicted.models)
    reported = report(replace(predicted, models=models), matrix(rows))
    assert reported.forecasts["good"].weights == pytest.approx({"good": 1 / 3, "poor": 0.0, "fair": 2 / 3})


def test_one_model_alone_is_too_few():
    assert forecasts(matrix({"good": {"good": 9.0}}), ERRORS) == {}
    assert forecasts(matrix({"good": {"good": 9.0, "fair": float("nan")}}), ERRORS) == {}


def test_a_forecast_is_in_the_units_of_the_task_and_moves_with_its_zero():
    rng = np.random.default_rng(0)
    trials = [rng.normal(mean, 1.0, size=50) for mean in (10.0, 9.0, 12.0)]
    known = {"errors": [0.1, 0.2, 0.3], "own": [False, True, False], "outside": [0.5, 0.2, 0.1]}
    plain = np.array(forecast_of(trials, **known, rest=[2.0] * 3))
    scaled = np.array(forecast_of([5.0 * one - 300.0 for one in trials], **known, rest=[-290.0] * 3))
    np.testing.assert_allclose(scaled, 5.0 * plain - 300.0)


def foretold(trials, **keywords):
    """Return the forecast from trials in models that predict equally well."""
    return forecast_of(trials, [0.0] * len(trials), [False] * len(trials), **keywords)


def width(*means, luck=(0.0,)):
    _, low, high = foretold([mean + np.array(luck) for mean in means])
    return high - low


def test_the_interval_is_wider_where_models_differ_and_narrower_where_more_agree():
    luck = [-1.0, 1.0] * 10
    assert width(8.0, 10.0, 12.0, luck=luck) > 2.0 * width(9.9, 10.0, 10.1, luck=luck)
    assert width(*[10.0] * 4, luck=luck) == pytest.approx(width(10.0, 10.0, luck=luck))  # all meet the same trials


def test_models_share_errors_so_the_interval_falls_with_the_fourth_root_of_their_number():
    assert width(9.0, 9.0, 11.0, 11.0) == pytest.approx(width(9.0, 11.0) / 2.0**0.25)


def test_the_interval_reaches_further_down_than_up_as_on_the_cars_of_the_calibration():
    assert foretold([np.full(2, 9.0), np.full(2, 11.0)]) == pytest.approx(
        (10.0, 10.0 - 3.5 / 2.0**0.25, 10.0 + 1.5 / 2.0**0.25)
    )


def test_what_models_agree_on_is_less_sure_where_they_predict_badly_and_less_outside_the_data():
    agreed = [np.full(2, 12.0)] * 2
    nothing, all_bad = (forecast_of(agreed, [error] * 2, [False] * 2, rest=[2.0, 2.0]) for error in (0.0, 1.0))
    assert nothing == (12.0, 12.0, 12.0)
    assert all_bad == pytest.approx((12.0, 12.0 - 3.5 * 0.3 * 10.0, 12.0 + 1.5 * 0.3 * 10.0))
    assert forecast_of(agreed, [5.0] * 2, [False] * 2, rest=[2.0, 2.0]) == all_bad  # no worse than the mean
    away = forecast_of(agreed, [0.0] * 2, [False] * 2, rest=[2.0, 2.0], outside=[0.4, 0.6])
    assert away == pytest.approx((11.0, 11.0 - 3.5 * 0.25 * 5.0, 11.0 + 1.5 * 0.25 * 5.0))
    assert foretold(agreed, outside=[None, 0.5]) == foretold(agreed, outside=[0.5, 0.5])  # where it is not known


def test_the_interval_falls_with_the_root_of_the_number_of_trials():
    one, four = (width(10.0, 10.0, luck=[-1.0, 1.0] * each) for each in (1, 4))
    assert one == pytest.approx((FORECAST_RULE.high - FORECAST_RULE.low) / np.sqrt(2.0))
    assert four == pytest.approx(one / 2.0)


def test_a_forecast_by_another_rule_believes_models_by_that_rule():
    trials = [np.full(2, mean) for mean in (8.0, 10.0, 12.0)]
    low, high = (
        forecast_of(trials, [0.1, 0.2, 0.3], [False, False, True], rule=ForecastRule(power=power))[0]
        for power in (9.0, 0.0)
    )
    assert low < 8.2 < 9.0 < high


def test_nine_in_ten_intervals_hold_where_what_is_missed_is_as_in_calibration():
    def drawn(seed, rule):
        rng = np.random.default_rng(seed)
        for _ in range(2000):
            truth = rng.normal(10.0, 3.0)
            trials = [np.full(2, mean) for mean in truth + rng.normal(0.0, 1.0, size=4)]
            yield truth, *foretold(trials, rule=rule)

    missed = [(truth - value) / (high - value) for truth, value, _, high in drawn(1, ForecastRule(low=-1.0, high=1.0))]
    low, high = np.quantile(missed, [0.05, 0.95])
    held = [lowest <= truth <= highest for truth, _, lowest, highest in drawn(2, ForecastRule(low=low, high=high))]
    assert 0.88 < np.mean(held) < 0.92


def test_what_is_achieved_is_held_against_the_interval_and_its_own_error():
    found = forecasts(matrix(CLAIMS), ERRORS)["good"]
    outside = found.low - 0.3 * (found.value - found.low)
    assert found.covers(Estimate(found.value, 0.0))
    assert not found.covers(Estimate(outside, 0.01))
    assert found.covers(Estimate(outside, found.value - found.low))
    assert not found.covers(Estimate(outside, float("nan")))


def test_the_trials_of_a_controller_become_one_by_the_rule_of_its_evolution():
    cells = [Cell("c", column, np.array([1.0, 2.0, 30.0]), unit="m") for column in ("a", "b")]
    usual = evolved("c", ("a",))
    cautious = TransferMatrix.of([replace(usual, aggregate="cvar(share=0.3)")], ("a", "b"), cells)
    hopeful = replace(cautious, champions=(usual,))
    assert forecasts(cautious, {})["c"].value < 2.0 < forecasts(hopeful, {})["c"].value


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
    worth = forecast_judgement(ERRORS, {name: name for name in ERRORS})
    by_model = np.array([[6.0, 9.0], [7.0, 8.0], [20.0, 4.0]])
    ranked = worth(evolved("poor", ("poor",)), ("good", "fair", "poor"), by_model)
    assert ranked[0] == pytest.approx(forecasts(matrix(CLAIMS), ERRORS)["poor"].value)


def test_a_baseline_is_chosen_only_if_its_forecast_is_higher_than_that_of_every_evolved_controller():
    rows = {"good": CLAIMS["good"], "hand": {"good": 30.0, "fair": 30.0, "poor": 30.0}}
    made = matrix(rows, against={"hand": ()})
    found = forecasts(made, ERRORS)
    assert found["hand"].value > found["good"].value
    assert best_choice(made, found) == "hand"
    level = matrix({name: dict.fromkeys(ERRORS, 5.0) for name in ("hand", "good")}, against={"hand": ()})
    assert best_choice(level, forecasts(level, ERRORS)) == "good"


def test_among_those_with_all_the_fitness_there_is_the_one_inside_the_data_is_chosen():
    rows = {name: {"a": 100.0, "b": value} for name, value in (("a", 100.0), ("b", 100.0), ("low", 90.0))}
    made = matrix(rows, against={"low": ("a",)})

    def chosen(shares, among=made):
        return best_choice(among, forecasts(among, {}, dict.fromkeys("ab", shares)))

    assert chosen({"a": 0.006, "b": 0.002, "low": 0.0}) == "b"
    assert chosen({"a": 0.001, "b": 0.002, "low": 0.0}) == "a"
    assert chosen({"b": 0.001}) == "b"  # what is not known is the last
    assert chosen({}) == "a"  # of equals the first
    poor = matrix({name: {"a": 10.0, "b": 10.0} for name in "ab"})  # the fitness of trials differs: not everything
    assert chosen({"a": 0.0, "b": 0.002}, poor) == "a"


def test_the_gain_is_counted_from_controls_at_rest_and_the_share_outside_is_that_of_all_models():
    rows = {"good": {"good": 9.0, "fair": 9.0}, "rest": {"good": 4.0, "fair": 4.0}}
    made = matrix(rows, against={"rest": ()})
    outside = {"good": {"good": 0.6, "rest": 0.0}, "fair": {"good": 0.1}}
    found = forecasts(made, ERRORS, outside)
    assert found["good"].outside == pytest.approx((0.6 * 0.5 + 0.1 * 0.25) / 0.75)
    assert found["good"].value == pytest.approx(9.0 - 0.2 * found["good"].outside * 5.0)
    assert (found["rest"].value, found["rest"].outside) == (4.0, 0.0)
    assert forecasts(made, ERRORS)["good"].outside is None


DATA = GivenData(example_dataset(), HoldOut()).cell()


def names(*columns):
    """Return which of these columns are believed: (label, family, error by horizon) of each model, and plants."""
    measured, plants = {}, []
    for column in columns:
        if not isinstance(column, Plant):
            label, family, measured[label] = column
            column = Plant(label, family, prediction=Predict(label, family, DATA).cell())
        plants.append(column)

    def prediction_of(cell):
        label = cell.settings.label
        errors = measured[label]
        scores = tuple(score(*one) for one in (errors or {}).items())
        warning = "worse than no change" if label.startswith("useless") else ""
        return None if errors is None else ModelPrediction(label, cell.settings.family, scores, warning=warning)

    work = CellContext(prediction_of, lambda done, total, note="": None, Path("unused"), Path("unused"), nowhere)
    return tuple(one.label for one in accurate_plants(plants, work))


def score(horizon, n):
    return ErrorScore(horizon, 10, *[np.full(3, n)] * 4, Draws(np.full(2, n), 2))


def nowhere(cell):
    raise AssertionError(f"nobody asks where {cell.title} stands")


UNMEASURED = [Plant("car", "car"), ("failed", "failed", None)]


@pytest.mark.parametrize(
    ("columns", "found"),
    [
        # near the best at one second; at the longest horizon where one second was not measured
        ([(str(n), str(n), {1: 1.0 - n, 20: n, 60: 1.0}) for n in (0.151, 0.149, 0.1)], ("0.149", "0.1")),
        ([("a", "a", {1: 0.9, 10: 0.1}), ("b", "b", {1: 0.1, 10: 0.1}), ("c", "c", {10: 0.9})], ("a", "b")),
        # the best of two families, so that one can judge the other
        ([("a", "x", {20: 0.1}), ("b", "x", {20: 0.12}), ("c", "y", {20: 0.4}), ("d", "z", {20: 0.5})], tuple("abc")),
        # one that fails the sanity check only where fewer than two families pass
        ([("a", "x", {20: 0.1}), ("b", "z", {20: 0.3}), ("useless", "y", {20: 0.1})], ("a", "b")),
        ([("a", "x", {20: 0.1}), ("useless", "y", {20: 0.1})], ("a", "useless")),
        ([("useless 1", "x", {20: 0.1}), ("useless 2", "y", {20: 0.4})], ("useless 1", "useless 2")),
        (UNMEASURED, ("car", "failed")),
        ([*UNMEASURED, *((n, n, {20: e}) for n, e in zip("abc", (1, 2, 3), strict=True))], ("car", "failed", "a", "b")),
        ([*UNMEASURED, ("a", "a", {20: 0.1}), ("b", "b", {20: 0.2})], ("car", "failed", "a", "b")),
    ],
)
def test_models_near_the_best_or_without_an_error_are_accurate(columns, found):
    assert names(*columns) == found
