"""The study of forecasts: on made-up cars its figures are known."""

from __future__ import annotations

import numpy as np
import pytest

from evaluation.transfer.forecast import FORECAST_RULE
from tests.benchmarks.forecast.judging import (
    Seen,
    asked_only,
    best_of_ten,
    calibrated,
    held,
    over_cars,
    rank_correlation,
    seen,
    with_term,
)
from tests.benchmarks.forecast.looking import Record


def made_up(cars: int = 5, each: int = 200, seed: int = 0, shift: float = 0.0) -> list[Seen]:
    """Return controllers with forecast errors of twice their unit, plus ``shift`` and the effect of one term."""
    rng, found = np.random.default_rng(seed), []
    for car in range(cars):
        for _ in range(each):
            forecast, unit, term = rng.normal(10.0, 3.0), rng.uniform(0.5, 1.0), rng.normal()
            achieved = forecast + 2.0 * unit * rng.normal() + shift + term
            found.append(Seen(car, f"{car}", achieved, forecast, unit, 20.0 - forecast, forecast, 0.1, {"term": term}))
    return found


def test_nine_in_ten_intervals_of_a_car_hold_when_the_others_calibrate_them() -> None:
    assert np.mean(held(made_up(), 0.9)) == pytest.approx(0.9, abs=0.02)


def test_a_car_has_no_part_in_its_own_interval() -> None:
    moved = [one if one.car else Seen(0, "0", one.achieved + 100.0, *list(vars(one).values())[3:]) for one in made_up()]
    holds = np.array(held(moved, 0.9))
    assert not holds[:200].any()
    assert calibrated(moved, 0.9)[1] > 10.0


def test_a_term_that_knows_what_is_missed_is_found_and_a_constant_with_it() -> None:
    found = made_up(shift=-3.0)
    better = with_term(found, "term")
    before = np.mean([(one.forecast - one.achieved) ** 2 for one in found])
    after = np.mean([(value - one.achieved) ** 2 for value, one in zip(better, found, strict=True)])
    assert after < before - 9.0


def test_who_ranks_as_what_is_achieved_loses_nothing_and_who_ranks_the_other_way_round_much() -> None:
    found = [Seen(0, "0", float(value), float(value), 1.0, -float(value), 0.0, 0.1) for value in range(1, 21)]
    assert rank_correlation(found, lambda one: one.forecast) == pytest.approx(1.0)
    assert rank_correlation(found, lambda one: one.claimed) == pytest.approx(-1.0)
    assert best_of_ten(found, lambda one: one.forecast) == 0.0
    assert best_of_ten(found, lambda one: one.claimed) > 0.7


def test_an_interval_over_cars_is_wider_than_over_runs_where_cars_differ() -> None:
    by_run = {(car, f"{car}-{run}"): float(car) for car in range(5) for run in range(20)}
    mean, low, high = over_cars(by_run)
    assert mean == 2.0
    assert high - low > 2.0


def test_what_is_seen_is_forecast_by_the_rule_and_nothing_of_the_robot_enters() -> None:
    column = {"family": "a", "error": 0.1, "fitness": [9.0, 11.0], "outside": 0.1, "probed": 0.0}
    columns = {"a": column, "b": {**column, "family": "b", "fitness": [7.0, 9.0]}}
    record: Record = {"against": ["a"], "achieved": 5.0, "columns": columns}
    one, other = (seen({**record, "achieved": achieved}, 0, "0", FORECAST_RULE) for achieved in (5.0, 50.0))
    assert (one.forecast, one.unit, one.claimed, one.others) == (other.forecast, other.unit, 10.0, 8.0)
    assert 8.0 < one.forecast < 9.0


def test_terms_that_were_not_looked_at_are_none() -> None:
    columns = {name: {"family": name, "error": 0.1, "fitness": [9.0, 11.0]} for name in ("a", "b")}
    found = seen({"name": "c", "achieved": 9.5, "against": ["a"], "columns": columns}, 0, "", FORECAST_RULE)
    assert (found.name, found.forecast, dict(found.terms)) == ("c", 10.0, {})


def test_where_some_models_alone_are_asked_nobody_else_says_anything() -> None:
    column = {"family": "a", "error": 0.1, "fitness": [9.0, 11.0], "outside": 0.1, "probed": 0.0}
    columns = {"a": column, "b": {**column, "family": "b"}, "c": {**column, "family": "c"}}
    records: list[Record] = [
        {"against": list(against), "achieved": 5.0, "columns": columns} for against in ("a", "ab", "c")
    ]
    found = asked_only(records, ("a", "b"))
    assert [record["against"] for record in found] == [["a"], ["a", "b"]]
    assert all(list(record["columns"]) == ["a", "b"] for record in found)
