"""The figures of a study, on results whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import t as student

from evaluation.study.figures import (
    CHOSEN,
    HINDSIGHT,
    Spread,
    controller_figures,
    differences,
    exploit_figures,
    forecast_figures,
    interquartile_mean,
    prediction_axes,
    prediction_figures,
    probability_of_improvement,
)
from evaluation.study.results import ControllerRow, HorizonError, ModelRow, with_best_known
from tests.fixtures.studies import made_up

SHARES = [value / best for best in (10.0, 11.0, 12.0) for value in (best - 1.0,)]
"""Of the best_known of each car, what ``both`` achieves."""


@pytest.fixture(scope="module")
def results():
    return made_up()


def test_a_share_is_of_the_best_on_the_same_robot(results):
    figures = {one.controller: one for one in controller_figures(results)}
    best, both = figures["best"].normalised, figures["both"].normalised
    assert (best.mean, best.low, best.high) == (1.0, 1.0, 1.0)
    assert both.mean == pytest.approx(sum(SHARES) / 3)
    assert both.lowest == pytest.approx(0.9)


def test_what_the_program_picks_and_what_was_best_are_rows_of_their_own(results):
    figures = {one.controller: one for one in controller_figures(results)}
    assert figures[CHOSEN].normalised == figures["both"].normalised
    assert figures[HINDSIGHT].normalised == figures["best"].normalised


def test_others_are_compared_with_the_recommended_controller_or_the_named_one(results):
    figures = {one.controller: one for one in controller_figures(results)}
    assert figures["both"].is_reference
    assert figures["best"].difference.mean == pytest.approx(sum(SHARES) / 3 - 1.0)
    asked = made_up()
    named = type(asked.study)(asked.study.title, {}, asked.study.grids, {"controller": "worse"})
    other = {one.controller: one for one in controller_figures(type(asked)(named, asked.points, (), asked.controllers))}
    assert other["worse"].is_reference
    assert not other["both"].is_reference


def test_a_claim_that_is_too_high_is_seen_as_that(results):
    gaps = {one.controller: one.gap.mean for one in controller_figures(results) if one.gap is not None}
    assert gaps["worse"] == pytest.approx(4.0)
    assert gaps["best"] == 0.0


def test_an_axis_that_is_no_repetition_makes_groups_of_rows():
    figures = controller_figures(made_up(procedure=["recommended", "plain"]))
    assert {one.group for one in figures} == {("recommended",), ("plain",)}
    assert len({(one.group, one.controller) for one in figures}) == len(figures)


def test_forecasts_claims_and_errors_are_judged_within_a_point(results):
    figures = {one.figure: one for one in forecast_figures(results)}
    forecast, claim, error = figures["forecast"], figures["claim"], figures["prediction error"]
    assert forecast.correlation.mean == pytest.approx(0.5)  # both 10.5 before best 10 and worse 8
    assert claim.correlation.mean == pytest.approx(-0.5)
    assert forecast.loss.mean == pytest.approx(1.0 - sum(SHARES) / 3)
    assert error.loss.mean == 0.0
    assert forecast.inside.mean == pytest.approx(2 / 3)
    assert claim.inside is None
    assert forecast.rmse == pytest.approx((1.5**2 / 3) ** 0.5)


def test_an_unfinished_point_is_left_out_of_the_figures_on_choosing(results):
    partial = made_up(missing=results.points[0].name)
    assert forecast_figures(partial)[0].controllers == forecast_figures(results)[0].controllers - 3
    chosen = next(one for one in controller_figures(partial) if one.controller == CHOSEN)
    assert chosen.normalised.points == len(results.points) - 1


def test_errors_of_a_family_are_shown_once_if_an_axis_does_not_change_them():
    figures = prediction_figures(made_up(procedure=["recommended", "plain"]))
    assert [(one.model, one.group) for one in figures] == [("best", ()), ("worse", ())]
    assert figures[0].n[20].mean == pytest.approx(2.0)
    assert figures[0].fits == 9


def test_how_often_a_model_is_exploited_is_counted_over_points(results):
    assert [(one.model, one.exploited, one.assessed) for one in exploit_figures(results)] == [
        ("best", 0, 9),
        ("worse", 9, 9),
    ]


def drawn(rng, robots, seeds, among, within):
    """Return numbers about 0: robots ``among`` each other, seeds ``within`` each."""
    return {
        (f"r{robot}", str(seed)): value + within * rng.normal()
        for robot, value in enumerate(among * rng.normal(size=robots))
        for seed in range(seeds)
    }


def test_every_robot_has_the_same_weight_whatever_its_number_of_seeds():
    spread = Spread.of({("a", "0"): 1.0, ("a", "1"): 1.0, ("a", "2"): 1.0, ("b", "0"): 3.0})
    assert spread.mean == 2.0
    assert (spread.lowest, spread.highest, spread.robots, spread.points) == (1.0, 3.0, 2, 4)


@pytest.mark.parametrize(
    "robots, seeds, there", [(1, 1, False), (2, 9, False), (1, 2, False), (1, 3, True), (3, 1, True)]
)
def test_there_is_no_interval_of_too_few_robots_or_seeds(robots, seeds, there):
    spread = Spread.of(drawn(np.random.default_rng(0), robots, seeds, 1.0, 1.0))
    assert (spread.low is not None) == there
    assert (spread.high is not None) == there


def test_an_interval_is_over_robots_and_of_a_single_one_over_its_seeds():
    """Robots, or seeds, that do not differ add nothing to it."""
    among = Spread.of({(robot, seed): float(robot) for robot in "123" for seed in "456"})
    within = Spread.of({(robot, seed): float(seed) for robot in "123" for seed in "456"})
    alone = Spread.of({("1", seed): float(seed) for seed in "456"})
    reach = student.ppf(0.975, 2) / np.sqrt(3)
    assert (among.low, among.high) == pytest.approx((2.0 - reach, 2.0 + reach))
    assert (within.low, within.high) == (5.0, 5.0)
    assert (alone.low, alone.high) == pytest.approx((5.0 - reach, 5.0 + reach))


def test_a_paired_difference_is_that_of_robots_and_seeds_that_both_have():
    first = {("a", "0"): 5.0, ("a", "1"): 7.0, ("b", "0"): 9.0}
    assert differences(first, {("a", "0"): 1.0, ("b", "0"): 2.0, ("c", "0"): 3.0}) == {("a", "0"): 4.0, ("b", "0"): 7.0}


def test_what_is_no_number_is_left_out_and_of_nothing_there_is_no_spread():
    spread = Spread.of({("a", "0"): 1.0, ("a", "1"): float("nan")})
    assert spread.points == 1
    assert Spread.of({("a", "1"): float("nan")}) is None


def row(point, controller, achieved, **fields):
    """Return the row of a controller that was evolved in one model and claims what it achieves."""
    given = {"kind": "single", "members": (controller,), "claimed": achieved, "forecast": achieved, **fields}
    return ControllerRow(point.name, controller, achieved=achieved, **given)


def of(results, rows):
    return replace(results, controllers=with_best_known(list(results.points), list(rows)))


def figures_of(results):
    return {one.controller: one for one in controller_figures(results) if one.group == ()}


def test_what_was_evolved_on_the_robots_is_one_row_claims_nothing_and_is_no_choice():
    empty, rows = made_up(cars=2, seeds=1), list[ControllerRow]()
    for point in empty.points:
        rows += [row(point, "model", 10.0, chosen=True), row(point, point.where, 20.0, kind="robot", claimed=25.0)]
    results = of(empty, rows)
    figures = figures_of(results)
    assert list(figures) == ["one search on the robot", "model", CHOSEN, HINDSIGHT]
    assert figures["one search on the robot"].gap is None
    best = figures[HINDSIGHT].normalised
    assert (best.mean, best.points) == (0.5, 2)
    assert [one.controllers for one in forecast_figures(results)] == [2, 2, 2]


def test_controllers_that_failed_are_counted_and_stand_last_where_all_of_them_did():
    first, second = (empty := made_up(cars=1, seeds=2)).points
    rows = [row(first, "half", 1.0), row(second, "half", None, reason="it broke")]
    rows += [row(point, "none", None, reason="it broke") for point in (first, second)]
    rows += [row(first, "best", 4.0), row(second, "to come", None)]
    figures = figures_of(of(empty, rows))
    assert {name: (one.planned, one.failed) for name, one in figures.items()} == {
        "best": (1, 0),
        "half": (2, 1),
        "none": (2, 2),
    }
    assert list(figures) == ["best", "half", "none"]
    assert figures["none"].normalised is None


def test_where_nothing_is_recommended_others_are_compared_with_what_is_chosen():
    (point,) = (empty := made_up(cars=1, seeds=1)).points
    figures = figures_of(of(empty, [row(point, "best", 10.0), row(point, "worse", 5.0, chosen=True)]))
    assert [name for name, one in figures.items() if one.is_reference] == [CHOSEN]
    assert figures["best"].difference.mean == -0.5


def test_the_reference_is_in_the_group_that_the_study_names():
    results = made_up(cars=1, seeds=1, procedure=["recommended", "plain"])
    results = replace(results, study=replace(results.study, compare_with={"procedure": "plain"}))
    found = [(one.group, one.controller) for one in controller_figures(results) if one.is_reference]
    assert found == [(("plain",), "both")]


def test_what_was_best_is_known_of_finished_points_alone():
    name = made_up().points[0].name
    hindsight = figures_of(made_up(missing=name))[HINDSIGHT].normalised
    assert hindsight.points == 8
    assert figures_of(made_up())[HINDSIGHT].planned == 9


def test_a_controller_without_a_forecast_is_not_judged_and_an_error_misses_no_fitness():
    (point,) = (empty := made_up(cars=1, seeds=1)).points
    rows = [row(point, "one", 10.0, error=0.1), row(point, "two", 8.0, error=0.2), row(point, "x", 99.0, forecast=None)]
    figures = {one.figure: one for one in forecast_figures(of(empty, rows))}
    assert {one.controllers for one in figures.values()} == {2}
    assert figures["claim"].rmse == 0.0
    assert figures["prediction error"].rmse is None
    assert figures["prediction error"].loss.mean == 0.0


def test_a_share_is_measured_from_the_floor_and_there_is_none_of_nothing():
    points = list(made_up(cars=3, seeds=1).points)
    rows = [row(points[0], "a", -4.0, rest_fitness=-10.0), row(points[0], "b", -8.0, rest_fitness=-10.0)]
    rows += [row(points[1], "a", 3.0, rest_fitness=3.0), row(points[2], "a", np.inf), row(points[2], "b", 2.0)]
    found = with_best_known(points, rows)
    assert [one.best_known for one in found] == [-4.0, -4.0, 3.0, 2.0, 2.0]
    assert [one.normalised for one in found[:3]] == pytest.approx([1.0, 1.0 / 3.0, None])
    assert found[4].normalised == 1.0


def test_tasks_on_one_robot_have_a_yardstick_each():
    one, other = made_up(cars=1, seeds=2).points
    points = [replace(one, task="near"), replace(other, task="far")]
    found = with_best_known(points, [row(points[0], "a", 2.0), row(points[1], "a", 8.0)])
    assert [row.normalised for row in found] == [1.0, 1.0]


def model(point, name, *errors, **fields):
    found = tuple(HorizonError(h, n, n, n) for h, n in zip((10, 20, 60), errors, strict=False))
    return ModelRow(point.name, name, name, found, **fields)


def test_models_stand_by_their_error_after_a_second_those_that_failed_last():
    (point,) = (empty := made_up(cars=1, seeds=1)).points
    rows = (
        model(point, "broken", reason="no fit"),
        model(point, "soon", 0.1, 0.4, 0.8, seconds=3.0, kept=0.5, exploited=True),
        model(point, "late", 0.2, 0.3, 0.9, seconds=5.0),
    )
    figures = prediction_figures(replace(empty, models=rows))
    assert [(one.model, one.fits, one.failed) for one in figures] == [("late", 1, 0), ("soon", 1, 0), ("broken", 1, 1)]
    assert [one.seconds and one.seconds.mean for one in figures] == [5.0, 3.0, None]
    (judged,) = exploit_figures(replace(empty, models=rows))
    assert (judged.model, judged.exploited, judged.assessed) == ("soon", 1, 1)
    assert judged.kept.mean == 0.5


def test_an_axis_separates_errors_if_it_changes_those_of_any_model_on_the_same_robot_and_seed():
    empty = made_up(cars=2, seeds=2, procedure=["recommended", "plain"])

    def errors(point, changed):
        return 1.0 + len(point.where) + 0.1 * float(point.seed) + (0.01 if changed else 0.0)

    same = [model(point, "a", errors(point, False)) for point in empty.points]
    assert prediction_axes(replace(empty, models=tuple(same))) == ()
    plain = [model(point, "b", errors(point, "plain" in point.group)) for point in empty.points]
    assert prediction_axes(replace(empty, models=(*same, *plain))) == ("procedure",)


def test_the_interquartile_mean_leaves_out_the_lowest_and_the_highest_quarter():
    values = {("car", str(seed)): value for seed, value in enumerate((0.0, 2.0, 4.0, 100.0))}
    assert interquartile_mean(values) == 3.0
    five = {("car", str(seed)): value for seed, value in enumerate((0.0, 1.0, 2.0, 3.0, 50.0))}
    assert interquartile_mean(five) == pytest.approx(2.0)
    assert interquartile_mean({}) is None


def test_the_probability_of_improvement_is_that_of_a_pair_of_seeds_on_the_same_robot():
    first = {("a", "0"): 1.0, ("a", "1"): 3.0, ("b", "0"): 5.0}
    second = {("a", "0"): 2.0, ("a", "1"): 3.0, ("b", "0"): 5.0, ("c", "0"): 0.0}
    assert probability_of_improvement(first, second) == pytest.approx((1.5 / 4 + 0.5) / 2)
    assert probability_of_improvement(first, {("c", "0"): 0.0}) is None
