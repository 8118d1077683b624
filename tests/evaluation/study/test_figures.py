"""The figures of a study, on results whose truth is known."""

import pytest

from evaluation.study import (
    CHOSEN,
    HINDSIGHT,
    controller_figures,
    exploit_figures,
    forecast_figures,
    prediction_figures,
)
from tests.fixtures.studies import made_up

SHARES = [value / best for best in (10.0, 11.0, 12.0) for value in (best - 1.0,)]
"""Of the yardstick of each car, what ``both`` achieves."""


@pytest.fixture(scope="module")
def results():
    return made_up()


def test_a_share_is_of_the_best_on_the_same_robot(results):
    figures = {one.controller: one for one in controller_figures(results)}
    best, both = figures["best"].share, figures["both"].share
    assert best is not None
    assert (best.mean, best.low, best.high) == (1.0, 1.0, 1.0)
    assert both is not None
    assert both.mean == pytest.approx(sum(SHARES) / 3)
    assert both.lowest == pytest.approx(0.9)


def test_what_the_program_picks_and_what_was_best_are_rows_of_their_own(results):
    figures = {one.controller: one for one in controller_figures(results)}
    assert figures[CHOSEN].share == figures["both"].share
    assert figures[HINDSIGHT].share == figures["best"].share


def test_others_are_compared_with_the_recommended_controller_or_the_named_one(results):
    figures = {one.controller: one for one in controller_figures(results)}
    assert figures["both"].is_reference
    assert figures["best"].difference is not None
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
    figures = controller_figures(made_up(recipe=["recommended", "plain"]))
    assert {one.group for one in figures} == {("recommended",), ("plain",)}
    assert len({(one.group, one.controller) for one in figures}) == len(figures)


def test_forecasts_claims_and_errors_are_judged_within_a_point(results):
    figures = {one.figure: one for one in forecast_figures(results)}
    forecast, claim, error = figures["forecast"], figures["claim"], figures["prediction error"]
    assert forecast.correlation is not None
    assert forecast.correlation.mean == pytest.approx(0.5)  # both 10.5 before best 10 and worse 8
    assert claim.correlation is not None
    assert claim.correlation.mean == pytest.approx(-0.5)
    assert forecast.loss is not None
    assert forecast.loss.mean == pytest.approx(1.0 - sum(SHARES) / 3)
    assert error.loss is not None
    assert error.loss.mean == 0.0
    assert forecast.inside is not None
    assert forecast.inside.mean == pytest.approx(2 / 3)
    assert claim.inside is None
    assert forecast.rmse == pytest.approx((1.5**2 / 3) ** 0.5)


def test_an_unfinished_point_has_no_part_in_what_is_said_of_choosing(results):
    partial = made_up(missing=results.points[0].name)
    assert forecast_figures(partial)[0].controllers == forecast_figures(results)[0].controllers - 3
    chosen = next(one for one in controller_figures(partial) if one.controller == CHOSEN)
    assert chosen.share is not None
    assert chosen.share.points == len(results.points) - 1


def test_errors_of_a_family_stand_once_where_an_axis_does_not_change_them():
    figures = prediction_figures(made_up(recipe=["recommended", "plain"]))
    assert [(one.model, one.group) for one in figures] == [("best", ()), ("worse", ())]
    assert figures[0].n[20] is not None
    assert figures[0].n[20].mean == pytest.approx(2.0)
    assert figures[0].fits == 9


def test_how_often_a_model_is_exploited_is_counted_over_points(results):
    assert [(one.model, one.exploited, one.judged) for one in exploit_figures(results)] == [
        ("best", 0, 9),
        ("worse", 9, 9),
    ]
