"""The verdict: each of its sentences is said where it is true, and not where it is false."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from evaluation.prediction import PredictionProtocol, measured_cases
from evaluation.report import Report, tells_nothing, verdict
from sysid_evo.data import Dataset
from tests.fixtures.known_models import recording
from tests.fixtures.reports import matrix, prediction, report

GOOD = {"persistence": 0.9, "linear": 0.3, "sindy": 0.6}
Made = Callable[[], Report]


def told(made: Report) -> str:
    return " ".join(answer for finding in verdict(made) for answer in finding.answers)


def predicted(**n: float) -> Report:
    return report(prediction({"persistence": 0.9, **n}))


def driven(**changes: object) -> Report:
    """Three controllers on a robot: one keeps its claim, one keeps some of it, one loses it."""
    fitness = {
        "a": {"a": 10.0, "b": 9.0, "c": 8.0, "car": 9.5},
        "b": {"a": 3.0, "b": 12.0, "c": 5.0, "car": 8.0},
        "c": {"a": 1.0, "b": 2.0, "c": 14.0, "car": 2.0},
    }
    return report(transfer=matrix(fitness, robot="car", **changes))  # type: ignore[arg-type]


def on_models(*fitness: float) -> Report:
    """Controllers that claim 10 on their model and reach these fitnesses on the other one."""
    rows = ("a", "b")[: len(fitness)]
    return report(
        transfer=matrix({row: {row: 10.0, "ba"[i]: fitness[i]} for i, row in enumerate(rows)}),
    )


SENTENCES: dict[str, tuple[Made, Made]] = {
    "At 20 steps (1 s), linear is best: N, the mean error in standard deviations, is 0.300 (0.280 to 0.320); "
    "persistence has 0.900.": (lambda: report(prediction(GOOD)), lambda: predicted(linear=1.2)),
    "In free run, linear is best: N, the mean error in standard deviations, is 0.300": (
        lambda: report(prediction(free=GOOD, steps=20)),
        lambda: report(prediction(GOOD, GOOD)),
    ),
    "No model predicts here: at 20 steps (1 s) the lowest N, the mean error in standard deviations, is 1.130 "
    "(1.110 to 1.150), of linear; persistence has 1.400; from 1 on, a constant would do as well.": (
        lambda: report(prediction({"persistence": 1.4, "linear": 1.13, "sindy": 1.3})),
        lambda: report(prediction({"persistence": 1.4, "linear": 0.97, "sindy": 1.3})),
    ),
    "no model is significantly better than a constant, which has 1.": (
        lambda: report(prediction({"persistence": 1.4, "linear": 0.99})),
        lambda: report(prediction({"persistence": 1.4, "linear": 0.97})),
    ),
    "no model is significantly better than that.": (
        lambda: predicted(linear=0.9),
        lambda: predicted(linear=0.3),
    ),
    "No significant difference from it: sindy.": (
        lambda: predicted(linear=0.300, sindy=0.301),
        lambda: predicted(linear=0.3, sindy=0.6),
    ),
    "Not significantly better than persistence: sindy.": (
        lambda: predicted(linear=0.3, sindy=0.9),
        lambda: predicted(linear=0.3, sindy=0.6),
    ),
    "In free run over whole episodes, linear is best: N 0.300.": (
        lambda: report(prediction(GOOD, GOOD)),
        lambda: report(prediction(GOOD, {"persistence": 1.9, "linear": 1.2})),
    ),
    "In free run over whole episodes, no model predicts: the lowest N is 1.200, of linear.": (
        lambda: report(prediction(GOOD, {"persistence": 1.9, "linear": 1.2})),
        lambda: report(prediction(GOOD, GOOD)),
    ),
    "Simulations reach their clip: linear (25 % of windows).": (
        lambda: report(prediction(GOOD, clipped={"linear": 0.25})),
        lambda: report(prediction(GOOD)),
    ),
    "The test set is too short to say: no horizon and no free run fits into it.": (
        lambda: report(prediction(steps=5)),
        lambda: report(prediction(GOOD)),
    ),
    "No model could be scored.": (
        lambda: report(prediction({"persistence": 0.9}, failed=["linear"])),
        lambda: report(prediction(GOOD, failed=["broken"])),
    ),
    "No controller was evolved.": (lambda: report(transfer=matrix({})), driven),
    "No controller could be run anywhere.": (
        lambda: report(transfer=matrix({"a": {"a": float("nan"), "b": float("nan")}})),
        driven,
    ),
    "No controller could be run on the robot.": (
        lambda: report(transfer=matrix({"a": {"a": 9.0, "car": float("nan")}}, robot="car")),
        driven,
    ),
    "Most on the robot: a, 9.50 (9.44 to 9.56) waypoints.": (driven, lambda: driven(robot_trials=1)),
    "Most on the robot: a, 9.50 waypoints.": (lambda: driven(robot_trials=1), driven),
    "At least nine tenths of their claim is kept on the robot by a.": (
        driven,
        lambda: report(transfer=matrix({"a": {"a": 10.0, "car": 8.9}}, robot="car")),
    ),
    "No controller keeps nine tenths of its claim on the robot.": (
        lambda: report(transfer=matrix({"a": {"a": 10.0, "car": 8.9}}, robot="car")),
        driven,
    ),
    "Less than half of it: c (14 %).": (
        driven,
        lambda: report(transfer=matrix({"c": {"c": 14.0, "car": 7.1}}, robot="car")),
    ),
    "There is no robot and no other model to transfer to.": (
        lambda: report(transfer=matrix({"a": {"a": 9.0}})),
        lambda: on_models(9.5),
    ),
    "Nothing was run on the robot. On the other models (mean fitness), a keep at least nine tenths of the claim.": (
        lambda: on_models(9.1, 8.9),
        driven,
    ),
    "no controller keeps at least nine tenths of the claim.": (lambda: on_models(8.9), lambda: on_models(9.1)),
    "Less than half of it, in mean fitness (waypoints): a (10.00 to 4.90).": (
        lambda: on_models(4.9, 5.1),
        lambda: on_models(5.1, 5.1),
    ),
    "No controller can be judged by models of other families; add a family to choose by.": (
        lambda: report(transfer=matrix({"a": {"a": 9.0, "car": 8.0}}, robot="car")),
        driven,
    ),
    "Chosen without the robot: a, the highest of 3 forecasts: 8.8 (7.6 to 9.4) waypoints are expected of it; "
    "it achieves 9.50 on the robot, outside the interval.": (driven, lambda: on_models(8.5)),
    "it achieves 8.20 on the robot, as forecast.": (
        lambda: report(transfer=matrix({"a": {"a": 9.0, "b": 8.0, "car": 8.2}}, robot="car")),
        driven,
    ),
    "Chosen without the robot: a, the only one with a forecast: 9.0 (7.7 to 9.7) waypoints are expected of it.": (
        lambda: on_models(8.5),
        driven,
    ),
    "Chosen with the robot: b, 9.00 on it.": (
        lambda: report(
            transfer=matrix({"a": {"a": 9.0, "b": 8.0, "car": 5.0}, "b": {"a": 7.0, "b": 9.0, "car": 9.0}}, robot="car")
        ),
        driven,
    ),
    "Rank correlation of claimed with achieved: -1.00 (3 controllers).": (driven, lambda: on_models(9.0, 9.0)),
    "Rank correlation of median on other families with achieved: +1.00 (3 controllers).": (
        driven,
        lambda: report(
            transfer=matrix({"a": {"a": 9.0, "b": 8.0, "car": 5.0}, "b": {"a": 7.0, "b": 9.0, "car": 9.0}}, robot="car")
        ),
    ),
    "Rank correlation of forecast with achieved: +1.00 (3 controllers).": (driven, lambda: on_models(9.0, 9.0)),
    "One evolution seed: how far a claim varies from seed to seed is unknown.": (
        lambda: driven(seeds=(9.0,)),
        lambda: driven(seeds=(9.0, 8.0, 8.5)),
    ),
    "A single trial on the robot has no error and judges no claim: a, b, c.": (
        lambda: driven(robot_trials=1),
        lambda: driven(robot_trials=2),
    ),
    "1 part; the reasons are listed below.": (lambda: report(failures=1), lambda: report(failures=2)),
    "2 parts; the reasons are listed below.": (lambda: report(failures=2), lambda: report(prediction(GOOD))),
    "Nothing was compared.": (report, lambda: report(prediction(GOOD))),
    "Nothing: no model could be scored. Look at the failures and notes, or record more data.": (
        lambda: report(prediction(steps=5)),
        lambda: report(prediction(GOOD)),
    ),
    "Nothing: no model could be scored and no controller could be run. Look at": (
        lambda: report(prediction(steps=5), matrix({"a": {"a": float("nan")}})),
        lambda: report(prediction(steps=5), matrix({"a": {"a": 3.0}})),
    ),
}


@pytest.mark.parametrize("sentence", SENTENCES)
def test_a_sentence_is_said_where_it_is_true_and_not_where_it_is_false(sentence: str) -> None:
    true, false = SENTENCES[sentence]
    assert sentence in told(true())
    assert sentence not in told(false())


def test_a_model_that_is_only_as_good_as_a_constant_is_never_called_best() -> None:
    useless = report(prediction({"persistence": 1.4, "linear": 1.13}, {"persistence": 1.9, "linear": 1.9}))
    assert "best" not in told(useless)


def test_a_model_predicts_where_its_whole_interval_is_below_that_of_the_mean() -> None:
    assert "linear is best" in told(report(prediction({"persistence": 1.4, "linear": 0.975})))
    assert "No model predicts" in told(report(prediction({"persistence": 1.4, "linear": 0.985})))
    assert "No model predicts" in told(report(prediction({"persistence": 1.4, "linear": 1.01})))


def test_a_best_model_that_persistence_matches_leaves_the_word_to_one_that_beats_it() -> None:
    both = {"persistence": 0.52, "lucky": 0.5, "steady": 0.51}
    wide = prediction(both, spread=0.001)
    assert "lucky is best" in told(report(wide))
    assert "No model predicts here" in told(report(prediction(both, spread=0.1)))


@pytest.mark.parametrize(
    "horizons, chosen", [((1, 10, 20, 60), 20), ((1, 10), 10), ((40, 60), 40), ((), None), ((5, 19, 21), 19)]
)
def test_the_verdict_stands_at_the_longest_horizon_of_at_most_one_second(
    horizons: tuple[int, ...], chosen: int | None
) -> None:
    made = prediction(GOOD)
    assert replace(made.cases, horizons=horizons).main_horizon == chosen


@pytest.mark.parametrize(
    "dt, chosen, horizons",
    [
        (0.005, 200, (1, 10, 20, 60, 200)),
        (0.02, 50, (1, 10, 20, 50, 60)),
        (0.05, 20, (1, 10, 20, 60)),
        (0.1, 10, (1, 10, 20, 60)),
        (0.3, 3, (1, 3, 10, 20, 60)),
        (0.7, 10, (1, 10, 20, 60)),
        (30.0, 10, (1, 10, 20, 60)),
    ],
)
def test_the_verdict_stands_at_the_step_nearest_to_one_second_and_never_at_the_first(
    dt: float, chosen: int, horizons: tuple[int, ...]
) -> None:
    data = recording(2, steps=250)
    slower = [replace(episode, dt=dt, pose=None) for episode in data]
    dataset = Dataset(replace(data.system, dt=dt, motion=None), tuple(slower))
    made = measured_cases(dataset, dataset, PredictionProtocol())
    assert (made.main_horizon, made.horizons) == (chosen, horizons)
    asked = measured_cases(dataset, dataset, PredictionProtocol(horizons=(1, 5)))
    assert asked.horizons == (1, 5)


def test_n_is_spelled_out_where_it_first_stands() -> None:
    for made in (report(prediction(GOOD, GOOD)), predicted(linear=1.2)):
        text = told(made)
        assert text.index("N, the mean error in standard deviations,") == text.index("N, ")


def test_people_claim_nothing_and_leave_no_question_of_seeds_open() -> None:
    human = report(transfer=matrix({"anna": {"car": 30.0}}, against={"anna": ()}, robot="car"))
    assert "evolution seed" not in told(human)
    assert "claim" not in told(human)


def test_a_yardstick_evolved_on_the_robot_keeps_no_claim() -> None:
    fitness = {"a": {"a": 10.0, "car": 5.0}, "car": {"a": 1.0, "car": 12.0}}
    text = told(report(transfer=matrix(fitness, robot="car")))
    assert "Most on the robot: a, 5.0" in text
    assert "One search on the robot itself, no longer than one in a model, reaches car, 12.0" in text
    assert "No controller keeps nine tenths of its claim on the robot." in text


@pytest.mark.parametrize(
    ("achieved", "expected"),
    [(9.0, "a achieves 75 % of that."), (15.0, "a achieves more than that search, which is no upper limit.")],
)
def test_no_share_of_more_than_all_is_stated(achieved: float, expected: str) -> None:
    fitness = {
        "a": {"a": 16.0, "b": 15.0, "car": achieved},
        "b": {"a": 1.0, "b": 2.0, "car": 1.0},
        "car": {"a": 1.0, "b": 1.0, "car": 12.0},
    }
    text = told(report(transfer=matrix(fitness, robot="car")))
    assert expected in text
    assert "125 %" not in text


def test_a_controller_that_was_polished_on_all_models_is_chosen_although_no_other_family_is_left_to_judge_it() -> None:
    fitness = {
        "a": {"a": 10.0, "b": 8.5, "car": 5.0},
        "b": {"a": 8.0, "b": 9.0, "car": 8.5},
        "best": {"a": 9.0, "b": 9.5, "car": 8.0},
    }
    text = told(report(transfer=matrix(fitness, against={"best": ("a", "b")}, robot="car")))
    assert "Chosen without the robot: best, the highest of 3 forecasts: 9.2 (" in text
    assert "Chosen with the robot: b, 8.50 on it." in text


def test_a_report_tells_something_with_one_score_or_one_finished_cell() -> None:
    assert tells_nothing(report())
    assert tells_nothing(report(prediction(steps=5)))
    assert tells_nothing(report(prediction({"persistence": 0.9}), matrix({"a": {"a": float("nan")}})))
    assert not tells_nothing(report(prediction({"linear": 0.9})))
    assert not tells_nothing(report(prediction(free={"linear": 0.9})))
    assert not tells_nothing(report(transfer=matrix({"a": {"a": 1.0}})))


def test_a_report_with_something_to_tell_asks_its_three_questions() -> None:
    whole = report(prediction(GOOD), driven(seeds=(1.0, 2.0)).matrix)
    assert [finding.question for finding in verdict(whole)] == [
        "Which models predict?",
        "Which controllers transfer?",
        "What to use?",
    ]


def below_zero(rest: float | None) -> str:
    """Return what is told of two controllers whose fitness is negative, with or without one at rest."""
    fitness = {"a": {"a": -200.0, "b": -250.0, "car": -220.0}, "car": {"a": -300.0, "b": -300.0, "car": -200.0}}
    if rest is not None:
        fitness["rest"] = {"a": rest, "b": rest, "car": rest}
    made = matrix(fitness, robot="car")
    champions = tuple(replace(c, polished=c.name == "a") for c in made.champions)
    return told(report(transfer=replace(made, champions=champions)))


def test_shares_of_a_negative_fitness_are_measured_from_controls_at_rest() -> None:
    text = below_zero(-1200.0)
    assert "a achieves 98 % of that." in text
    assert "At least nine tenths of their claim is kept on the robot by a." in text
    assert "Shares are measured from controls at rest: -1200 waypoints." in text
    far = below_zero(-230.0)
    assert "a achieves 33 % of that" in far
    assert "No controller keeps nine tenths of its claim" in far


def test_a_negative_fitness_has_no_shares_without_controls_at_rest() -> None:
    text = below_zero(None)
    assert "%" not in text
    assert "tenths of" not in text
