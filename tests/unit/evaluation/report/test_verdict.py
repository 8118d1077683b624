"""The verdict and the answers above it: each sentence is said where it is true, and not where it is false."""

from dataclasses import replace

import pytest

from evaluation.prediction import PredictionProtocol, measured_cases
from evaluation.report import tells_nothing, verdict
from evaluation.report.sections.summary import headlines
from evaluation.transfer import Estimate
from sysid_evo.data import Dataset
from tests.fixtures.known_models import recording
from tests.fixtures.reports import exploited, matrix, prediction, report

GOOD = {"persistence": 0.9, "linear": 0.3, "sindy": 0.6}


def told(made):
    return " ".join(answer for finding in verdict(made) for answer in finding.answers)


def scored(*n, **options):
    return report(prediction(*n, **options))


def predicted(**n):
    return scored({"persistence": 0.9, **n})


def on_robot(fitness, **options):
    return report(transfer=matrix(fitness, robot="car", **options))


def driven(**changes):
    """Three controllers on a robot: one keeps its claim, one keeps some of it, one loses it."""
    fitness = {
        "a": {"a": 10.0, "b": 9.0, "c": 8.0, "car": 9.5},
        "b": {"a": 3.0, "b": 12.0, "c": 5.0, "car": 8.0},
        "c": {"a": 1.0, "b": 2.0, "c": 14.0, "car": 2.0},
    }
    return on_robot(fitness, **changes)


def on_models(*fitness):
    """Controllers that claim 10 on their model and reach these fitnesses on the other one."""
    rows = ("a", "b")[: len(fitness)]
    return report(transfer=matrix({row: {row: 10.0, "ba"[i]: fitness[i]} for i, row in enumerate(rows)}))


SENTENCES = {
    "At 20 steps (1 s), linear is best: N, the mean error in standard deviations, is 0.300 (0.280 to 0.320); "
    "persistence has 0.900.": (lambda: scored(GOOD), lambda: predicted(linear=1.2)),
    "In free run, linear is best: N, the mean error in standard deviations, is 0.300": (
        lambda: scored(free=GOOD, steps=20),
        lambda: scored(GOOD, GOOD),
    ),
    "No model predicts here: at 20 steps (1 s) the lowest N, the mean error in standard deviations, is 1.130 "
    "(1.110 to 1.150), of linear; persistence has 1.400; from 1 on, a constant would do as well.": (
        lambda: scored({"persistence": 1.4, "linear": 1.13, "sindy": 1.3}),
        lambda: scored({"persistence": 1.4, "linear": 0.97, "sindy": 1.3}),
    ),
    "no model is significantly better than a constant, which has 1.": (
        lambda: scored({"persistence": 1.4, "linear": 0.99}),
        lambda: scored({"persistence": 1.4, "linear": 0.97}),
    ),
    "no model is significantly better than that.": (lambda: predicted(linear=0.9), lambda: predicted(linear=0.3)),
    "No significant difference from it: sindy.": (
        lambda: predicted(linear=0.300, sindy=0.301),
        lambda: predicted(linear=0.3, sindy=0.6),
    ),
    "Not significantly better than persistence: sindy.": (
        lambda: predicted(linear=0.3, sindy=0.9),
        lambda: predicted(linear=0.3, sindy=0.6),
    ),
    "In free run over whole episodes, linear is best: N 0.300.": (
        lambda: scored(GOOD, GOOD),
        lambda: scored(GOOD, {"persistence": 1.9, "linear": 1.2}),
    ),
    "In free run over whole episodes, no model predicts: the lowest N is 1.200, of linear.": (
        lambda: scored(GOOD, {"persistence": 1.9, "linear": 1.2}),
        lambda: scored(GOOD, GOOD),
    ),
    "Simulations reach their clip: linear (25 % of windows).": (
        lambda: scored(GOOD, clipped={"linear": 0.25}),
        lambda: scored(GOOD),
    ),
    "The test set is too short to say: no horizon and no free run fits into it.": (
        lambda: scored(steps=5),
        lambda: scored(GOOD),
    ),
    "No model could be scored.": (
        lambda: scored({"persistence": 0.9}, failed=["linear"]),
        lambda: scored(GOOD, failed=["broken"]),
    ),
    "No controller was evolved.": (lambda: report(transfer=matrix({})), driven),
    "No controller could be run anywhere.": (
        lambda: report(transfer=matrix({"a": {"a": float("nan"), "b": float("nan")}})),
        driven,
    ),
    "No controller could be run on the robot.": (lambda: on_robot({"a": {"a": 9.0, "car": float("nan")}}), driven),
    "Most on the robot: a, 9.50 (9.43 to 9.57) waypoints.": (driven, lambda: driven(robot_trials=1)),
    "Most on the robot: a, 9.50 waypoints.": (lambda: driven(robot_trials=1), driven),
    "At least nine tenths of their claim is kept on the robot by a.": (
        driven,
        lambda: on_robot({"a": {"a": 10.0, "car": 8.9}}),
    ),
    "No controller keeps nine tenths of its claim on the robot.": (
        lambda: on_robot({"a": {"a": 10.0, "car": 8.9}}),
        driven,
    ),
    "Less than half of it: c (14 %).": (driven, lambda: on_robot({"c": {"c": 14.0, "car": 7.1}})),
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
        lambda: on_robot({"a": {"a": 9.0, "car": 8.0}}),
        driven,
    ),
    "Chosen without the robot: a, the highest of 3 forecasts: 8.8 (7.6 to 9.4) waypoints are expected of it; "
    "it achieves 9.50 on the robot, outside the interval.": (driven, lambda: on_models(8.5)),
    "it achieves 8.20 on the robot, as forecast.": (lambda: on_robot({"a": {"a": 9.0, "b": 8.0, "car": 8.2}}), driven),
    "Chosen without the robot: a, the only one with a forecast: 9.0 (7.7 to 9.7) waypoints are expected of it.": (
        lambda: on_models(8.5),
        driven,
    ),
    "Chosen with the robot: b, 9.00 on it.": (
        lambda: on_robot({"a": {"a": 9.0, "b": 8.0, "car": 5.0}, "b": {"a": 7.0, "b": 9.0, "car": 9.0}}),
        driven,
    ),
    "Rank correlation of claimed with achieved: -1.00 (3 controllers).": (driven, lambda: on_models(9.0, 9.0)),
    "Rank correlation of median on other families with achieved: +1.00 (3 controllers).": (
        driven,
        lambda: on_robot({"a": {"a": 9.0, "b": 8.0, "car": 5.0}, "b": {"a": 7.0, "b": 9.0, "car": 9.0}}),
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
    "2 parts; the reasons are listed below.": (lambda: report(failures=2), lambda: scored(GOOD)),
    "Nothing was compared.": (report, lambda: scored(GOOD)),
    "Nothing: no model could be scored. Look at the failures and notes, or record more data.": (
        lambda: scored(steps=5),
        lambda: scored(GOOD),
    ),
    "Nothing: no model could be scored and no controller could be run. Look at": (
        lambda: report(prediction(steps=5), matrix({"a": {"a": float("nan")}})),
        lambda: report(prediction(steps=5), matrix({"a": {"a": 3.0}})),
    ),
}


@pytest.mark.parametrize("sentence", SENTENCES)
def test_a_sentence_is_said_where_it_is_true_and_not_where_it_is_false(sentence):
    true, false = SENTENCES[sentence]
    assert sentence in told(true())
    assert sentence not in told(false())


def test_a_model_that_is_only_as_good_as_a_constant_is_never_called_best():
    useless = scored({"persistence": 1.4, "linear": 1.13}, {"persistence": 1.9, "linear": 1.9})
    assert "best" not in told(useless)


def test_a_model_predicts_where_its_whole_interval_is_below_that_of_the_mean():
    assert "linear is best" in told(scored({"persistence": 1.4, "linear": 0.975}))
    assert "No model predicts" in told(scored({"persistence": 1.4, "linear": 0.985}))
    assert "No model predicts" in told(scored({"persistence": 1.4, "linear": 1.01}))


def test_a_best_model_that_persistence_matches_leaves_the_word_to_one_that_beats_it():
    both = {"persistence": 0.52, "lucky": 0.5, "steady": 0.51}
    assert "lucky is best" in told(scored(both, spread=0.001))
    assert "No model predicts here" in told(scored(both, spread=0.1))


@pytest.mark.parametrize(
    "horizons, chosen", [((1, 10, 20, 60), 20), ((1, 10), 10), ((40, 60), 40), ((), None), ((5, 19, 21), 19)]
)
def test_the_verdict_stands_at_the_longest_horizon_of_at_most_one_second(horizons, chosen):
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
def test_the_verdict_stands_at_the_step_nearest_to_one_second_and_never_at_the_first(dt, chosen, horizons):
    data = recording(2, steps=250)
    slower = [replace(episode, dt=dt, pose=None) for episode in data]
    dataset = Dataset(replace(data.system, dt=dt, motion=None), tuple(slower))
    made = measured_cases(dataset, dataset, PredictionProtocol())
    assert (made.main_horizon, made.horizons) == (chosen, horizons)
    asked = measured_cases(dataset, dataset, PredictionProtocol(horizons=(1, 5)))
    assert asked.horizons == (1, 5)


def test_n_is_spelled_out_where_it_first_stands():
    for made in (scored(GOOD, GOOD), predicted(linear=1.2)):
        text = told(made)
        assert text.index("N, the mean error in standard deviations,") == text.index("N, ")


TWO = {"a": {"a": 16.0, "b": 15.0}, "b": {"a": 1.0, "b": 2.0, "car": 1.0}, "car": {"a": 1.0, "b": 1.0, "car": 12.0}}
POLISHED = {
    "a": {"a": 10.0, "b": 8.5, "car": 5.0},
    "b": {"a": 8.0, "b": 9.0, "car": 8.5},
    "best": {"a": 9.0, "b": 9.5, "car": 8.0},
}


@pytest.mark.parametrize(
    ("made", "sentences", "unsaid"),
    [
        pytest.param(
            lambda: on_robot({"a": {"a": 10.0, "car": 5.0}, "car": {"a": 1.0, "car": 12.0}}),
            [
                "Most on the robot: a, 5.0",
                "One search on the robot itself, no longer than one in a model, reaches car, 12.0",
                "No controller keeps nine tenths of its claim on the robot.",
            ],
            [],
            id="a reference evolved on the robot keeps no claim",
        ),
        pytest.param(
            lambda: on_robot({**TWO, "a": {**TWO["a"], "car": 9.0}}),
            ["a achieves 75 % of that."],
            [],
            id="a share is stated",
        ),
        pytest.param(
            lambda: on_robot({**TWO, "a": {**TWO["a"], "car": 15.0}}),
            ["a achieves more than that search, which is no upper limit."],
            ["125 %"],
            id="but none of more than all",
        ),
        pytest.param(
            lambda: on_robot(POLISHED, against={"best": ("a", "b")}),
            [
                "Chosen without the robot: best, the highest of 3 forecasts: 9.25 (",
                "Chosen with the robot: b, 8.50 on it.",
            ],
            [],
            id="one polished on all models is chosen although no other family is left to judge it",
        ),
        pytest.param(
            lambda: on_robot({"anna": {"car": 30.0}}, against={"anna": ()}),
            ["anna"],
            ["evolution seed", "claim"],
            id="people claim nothing and leave no question of seeds open",
        ),
    ],
)
def test_what_is_said_of_controllers_on_a_robot(made, sentences, unsaid):
    text = told(made())
    assert [sentence for sentence in sentences if sentence not in text] == []
    assert [words for words in unsaid if words in text] == []


def test_a_report_tells_something_with_one_score_or_one_finished_cell():
    assert tells_nothing(report())
    assert tells_nothing(scored(steps=5))
    assert tells_nothing(report(prediction({"persistence": 0.9}), matrix({"a": {"a": float("nan")}})))
    assert not tells_nothing(scored({"linear": 0.9}))
    assert not tells_nothing(scored(free={"linear": 0.9}))
    assert not tells_nothing(report(transfer=matrix({"a": {"a": 1.0}})))


def test_a_report_with_something_to_tell_asks_its_three_questions():
    whole = report(prediction(GOOD), driven(seeds=(1.0, 2.0)).matrix)
    assert [finding.question for finding in verdict(whole)] == [
        "Which models predict?",
        "Which controllers transfer?",
        "What to use?",
    ]


def below_zero(rest):
    """Return what is told of two controllers whose fitness is negative, with or without one at rest."""
    fitness = {"a": {"a": -200.0, "b": -250.0, "car": -220.0}, "car": {"a": -300.0, "b": -300.0, "car": -200.0}}
    if rest is not None:
        fitness["rest"] = {"a": rest, "b": rest, "car": rest}
    made = matrix(fitness, robot="car")
    champions = tuple(replace(c, polished=c.name == "a") for c in made.champions)
    return told(report(transfer=replace(made, champions=champions)))


def test_shares_of_a_negative_fitness_are_measured_from_controls_at_rest():
    text = below_zero(-1200.0)
    assert "a achieves 98 % of that." in text
    assert "At least nine tenths of their claim is kept on the robot by a." in text
    assert "Shares are measured from controls at rest: -1200 waypoints." in text
    far = below_zero(-230.0)
    assert "a achieves 33 % of that" in far
    assert "No controller keeps nine tenths of its claim" in far


def test_a_negative_fitness_has_no_shares_without_controls_at_rest():
    text = below_zero(None)
    assert "%" not in text
    assert "tenths of" not in text


FITNESS = {"a": {"a": 10.0, "b": 9.0, "car": 4.0}, "b": {"a": 8.0, "b": 8.0, "car": 8.1}}


def judged(robot="car"):
    fitness = {row: {c: v for c, v in cells.items() if robot or c != "car"} for row, cells in FITNESS.items()}
    return replace(
        report(prediction({"persistence": 0.9, "a": 0.300, "b": 0.301, "c": 0.5}), matrix(fitness, robot=robot)),
        exploitability=(exploited(model="a"), exploited(model="b", gap=Estimate(0.1, 0.1))),
        controllers={"a": "controllers/a.json", "b": "controllers/b.json"},
        settings={"robot": robot},
    )


def answers(of):
    return {one.question: one for one in headlines(of)}


def test_the_best_models_that_do_not_differ_are_named_with_how_many_predict():
    best = answers(judged())["Which models predict?"]
    assert best.answer == "a, b"
    assert best.tone == "good"
    assert "N 0.300 (0.280 to 0.320), no significant difference between them; 3 of 3 predict." in best.sentence


def test_a_comparison_in_which_nothing_predicts_says_so():
    worst = answers(scored({"persistence": 0.5, "a": 1.2}))["Which models predict?"]
    assert (worst.answer, worst.tone) == ("None", "bad")
    assert "is that of a." in worst.sentence


def test_models_whose_claims_hold_can_be_trusted_and_exploited_ones_are_named():
    trusted = answers(judged())["Which models can be trusted?"]
    assert (trusted.answer, trusted.tone) == ("b", "good")
    assert "Exploited: a (claims 10.00, achieves 4.00)." in trusted.sentence
    none = answers(replace(judged(), exploitability=(exploited(model="a"),)))["Which models can be trusted?"]
    assert (none.answer, none.tone) == ("None", "bad")


def test_the_controller_to_take_comes_with_what_it_achieves_and_the_command_that_drives_it():
    taken = answers(judged())["Which controller to take?"]
    assert taken.answer == "a"
    assert taken.sentence.startswith("Claims 10.00 (9.93 to 10.07) waypoints, forecast ")
    assert taken.sentence.endswith(
        "), achieves 4.00 (3.93 to 4.07) on the robot. b does better there: 8.10 (8.03 to 8.17)."
    )
    assert taken.command == "sysid-evo drive --controller controllers/a.json --robot car"
    assert taken.tone == "bad"


def test_without_a_robot_the_answers_say_what_they_rest_on():
    taken = answers(judged(None))["Which controller to take?"]
    assert taken.sentence.endswith("reaches 9.00 (8.93 to 9.07) on the other models. Nothing was run on the robot.")
    assert taken.command == "sysid-evo export controllers/a.json --to c"


def test_without_a_part_the_answer_is_open_and_says_why():
    for one in headlines(report()):
        assert one.tone == "open"
        assert one.sentence
    assert answers(report())["Which controller to take?"].sentence == "No controller was evolved."
