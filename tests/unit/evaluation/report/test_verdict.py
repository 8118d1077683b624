"""The verdict and the answers above it: each sentence is said where it is true, and not where it is false."""

from dataclasses import replace
from datetime import date

import pytest

from evaluation.exploitability.results import UnderratedController
from evaluation.prediction.cases import PredictionProtocol, measured_cases
from evaluation.report.sections import models as models_section
from evaluation.report.sections.prediction import PredictionPart
from evaluation.report.sections.summary import facts, headlines, is_empty, page_title, verdict, warnings
from evaluation.results import Failure, ModelSummary
from sysid_evo.data import Dataset
from sysid_evo.plan.store import WAITING
from sysid_evo.validation.estimates import Estimate
from tests.fixtures.known_models import recording
from tests.fixtures.reports import exploited, matrix, prediction, report

GOOD = {"persistence": 0.9, "linear": 0.3, "sindy": 0.6}


def told(made):
    return " ".join(text for finding in verdict(made) for text in (finding.answer, *finding.sentences) if text)


def scored(*n, **options):
    return report(prediction(*n, **options))


def predicted(**n):
    return scored({"persistence": 0.9, **n})


def on_robot(fitness, **options):
    return report(transfer=matrix(fitness, robot="car", **options))


def driven(on_car=9.5, **changes):
    """Three controllers on a robot: one keeps its claim, one keeps some of it, one loses it."""
    fitness = {
        "a": {"a": 10.0, "b": 9.0, "c": 8.0, "car": on_car},
        "b": {"a": 3.0, "b": 12.0, "c": 5.0, "car": 8.0},
        "c": {"a": 1.0, "b": 2.0, "c": 14.0, "car": 2.0},
    }
    return on_robot(fitness, **changes)


def on_models(*fitness):
    """Controllers that claim 10 on their model and reach these fitnesses on the other one."""
    rows = ("a", "b")[: len(fitness)]
    return report(transfer=matrix({row: {row: 10.0, "ba"[i]: fitness[i]} for i, row in enumerate(rows)}))


SENTENCES = {
    "After 20 steps (1 s), its simulation error N is 0.300 (0.280 to 0.320).": (
        lambda: predicted(linear=0.3, sindy=0.6),
        lambda: predicted(linear=1.2),
    ),
    "Over whole episodes, its simulation error N is 0.300": (
        lambda: scored(free=GOOD, steps=20),
        lambda: scored(GOOD, GOOD),
    ),
    "After 20 steps (1 s), the lowest simulation error N is 1.13 (1.11 to 1.15), of linear. From 1 on, predicting the "
    "mean is as good.": (
        lambda: scored({"persistence": 1.4, "linear": 1.13, "sindy": 1.3}),
        lambda: scored({"persistence": 1.4, "linear": 0.97, "sindy": 1.3}),
    ),
    "No model is significantly better than predicting the mean, which has 1.": (
        lambda: scored({"persistence": 1.4, "linear": 0.99}),
        lambda: scored({"persistence": 1.4, "linear": 0.97}),
    ),
    "No model is significantly better than no change (persistence).": (
        lambda: predicted(linear=0.9),
        lambda: predicted(linear=0.3),
    ),
    "no significant difference between them": (
        lambda: predicted(linear=0.300, sindy=0.301),
        lambda: predicted(linear=0.3, sindy=0.6),
    ),
    "1 of 2 models predict, not sindy.": (
        lambda: predicted(linear=0.3, sindy=0.9),
        lambda: predicted(linear=0.3, sindy=0.6),
    ),
    "No model has a score; the notes and failures give the reasons.": (
        lambda: report(prediction({"persistence": 0.9}, failed=["linear"]), driven().matrix),
        lambda: scored(GOOD, failed=["broken"]),
    ),
    "No controller was evolved, because none was asked for.": (lambda: scored(GOOD), driven),
    "measured 9.90 (9.83 to 9.97) on car: outside the forecast.": (
        lambda: driven(on_car=9.9),
        lambda: driven(on_car=9.9, robot_trials=1),
    ),
    "measured 8.20 (8.13 to 8.27) on car: as forecast.": (
        lambda: on_robot({"a": {"a": 9.0, "b": 8.0, "car": 8.2}}),
        driven,
    ),
    "measured 9.50 on car": (lambda: driven(robot_trials=1), driven),
    "Its claim of 10.00 holds.": (driven, lambda: driven(robot_trials=1)),
    "Its claim of 10.00 cannot be checked.": (lambda: driven(robot_trials=1), driven),
    "Its claim of 10.00 is exploited.": (lambda: on_models(4.9, 5.1), driven),
    "Nothing was run on a robot.": (lambda: on_models(9.1, 8.9), driven),
    "Measured 8.00 (7.93 to 8.07) waypoints on car. Its claim of 9.00 is exploited. No forecast: no controller can be "
    "scored by models of other families. Add one with --models.": (
        lambda: on_robot({"a": {"a": 9.0, "car": 8.0}}),
        driven,
    ),
    "Forecast 8.8 (7.0 to 9.5) waypoints, measured": (driven, lambda: on_models(8.5)),
    "b does better on the robot, 9.00 (8.93 to 9.07), which was not known before the run.": (
        lambda: on_robot({"a": {"a": 9.0, "b": 8.9, "car": 5.0}, "b": {"a": 7.0, "b": 9.0, "car": 9.0}}),
        driven,
    ),
    "Each controller was evolved once; repeat with --repeats 3 to see how much claims vary.": (
        lambda: driven(seeds=(9.0,)),
        lambda: driven(seeds=(9.0, 8.0, 8.5)),
    ),
    "A single trial on the robot has no error and cannot test a claim: a, b, c.": (
        lambda: driven(robot_trials=1),
        lambda: driven(robot_trials=2),
    ),
    "1 step failed.": (lambda: report(failures=1), lambda: report(failures=2)),
    "2 steps failed.": (lambda: report(failures=2), lambda: scored(GOOD)),
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


def predicting(made):
    return answers(made)["Which models predict?"].answer


def test_a_model_predicts_where_its_whole_interval_is_below_that_of_the_mean():
    assert predicting(scored({"persistence": 1.4, "linear": 0.975})) == "linear"
    assert predicting(scored({"persistence": 1.4, "linear": 0.985})) == "None"
    assert predicting(scored({"persistence": 1.4, "linear": 1.01})) == "None"


def test_a_lowest_error_that_persistence_matches_does_not_predict():
    both = {"persistence": 0.52, "lucky": 0.5, "steady": 0.51}
    assert predicting(scored(both, spread=0.001)) == "lucky"
    assert predicting(scored(both, spread=0.1)) == "None"


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
            lambda: on_robot({**TWO, "a": {**TWO["a"], "car": 9.0}}),
            ["That is 75 % of the 12.00 that one search on the robot itself reached."],
            [],
            id="a share of the reference is stated",
        ),
        pytest.param(
            lambda: on_robot({**TWO, "a": {**TWO["a"], "car": 15.0}}),
            ["That is more than the 12.00 that one search on the robot itself reached."],
            ["125 %"],
            id="but none of more than all",
        ),
        pytest.param(
            lambda: on_robot(POLISHED, against={"best": ("a", "b")}),
            ["best Forecast 9.2 (", "b does better on the robot, 8.50"],
            [],
            id="one polished on all models is chosen although no other family is left to score it",
        ),
        pytest.param(
            lambda: on_robot({"anna": {"car": 30.0}}, against={"anna": ()}),
            [],
            ["evolved once", "Its claim"],
            id="people claim nothing and leave no question of seeds open",
        ),
    ],
)
def test_the_answer_on_controllers_compares_them_on_the_robot(made, sentences, unsaid):
    text = told(made())
    assert [sentence for sentence in sentences if sentence not in text] == []
    assert [words for words in unsaid if words in text] == []


def test_a_report_tells_something_with_one_score_or_one_finished_cell():
    assert is_empty(report())
    assert is_empty(scored(steps=5))
    assert is_empty(report(prediction({"persistence": 0.9}), matrix({"a": {"a": float("nan")}})))
    assert not is_empty(scored({"linear": 0.9}))
    assert not is_empty(scored(free={"linear": 0.9}))
    assert not is_empty(report(transfer=matrix({"a": {"a": 1.0}})))


def test_the_verdict_has_three_answers_and_what_is_not_known():
    whole = report(prediction(GOOD), driven(seeds=(1.0,)).matrix)
    assert [finding.question for finding in verdict(whole)] == [
        "Which controller to use?",
        "Which models predict?",
        "Which models can be trusted?",
        "What is not known?",
    ]


def below_zero(rest):
    """Return what is told of two controllers whose fitness is negative, with or without one at rest."""
    fitness = {"a": {"a": -200.0, "b": -250.0, "car": -220.0}, "car": {"a": -300.0, "b": -300.0, "car": -200.0}}
    if rest is not None:
        fitness["rest"] = rest if isinstance(rest, dict) else {"a": rest, "b": rest, "car": rest}
    made = matrix(fitness, robot="car")
    champions = tuple(replace(c, polished=c.name == "a") for c in made.champions)
    return told(report(transfer=replace(made, champions=champions)))


def test_shares_of_a_negative_fitness_are_measured_from_controls_at_rest():
    assert "That is 98 % of the -200.00 that one search" in below_zero(-1200.0)
    assert "That is 33 % of the -200.00 that one search" in below_zero({"a": -240.0, "b": -240.0, "car": -230.0})
    assert "%" not in below_zero(None)


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
    assert (
        "N is 0.300 (0.280 to 0.320); no significant difference between them. 3 of 3 models predict." in best.sentence
    )


def test_a_comparison_in_which_nothing_predicts_says_so():
    worst = answers(scored({"persistence": 0.5, "a": 1.2}))["Which models predict?"]
    assert (worst.answer, worst.tone) == ("None", "bad")
    assert worst.sentence.endswith(", of a. From 1 on, predicting the mean is as good.")


def test_models_whose_claims_hold_can_be_trusted_and_exploited_ones_are_named():
    trusted = answers(judged())["Which models can be trusted?"]
    assert (trusted.answer, trusted.tone) == ("b", "warn")
    assert "Not trusted: a (claims 10.00, achieves 4.00)." in trusted.sentence
    assert trusted.sentence.startswith("It predicts, and the claims of controllers evolved in it hold on the robot.")
    elsewhere = exploited(model="a").elsewhere  # the same figure, but not of a robot
    alone = replace(judged(), exploitability=(replace(exploited(model="a"), achieved=None, other_models=elsewhere),))
    sentence = answers(alone)["Which models can be trusted?"].sentence
    assert "Not trusted: a (claims 10.00, 4.00 on other models)." in sentence
    none = answers(replace(judged(), exploitability=(exploited(model="a"),)))["Which models can be trusted?"]
    assert (none.answer, none.tone) == ("None", "bad")


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        pytest.param(
            {"underrated": (UnderratedController("z", 1.0, 9.0),)}, "underrates a controller that", id="underrates"
        ),
        pytest.param({"model": "c"}, "does not predict", id="does not predict"),
    ],
)
def test_a_model_that_does_not_predict_or_underrates_controllers_is_not_trusted(changes, reason):
    held = exploited(**{"model": "b", "gap": Estimate(0.1, 0.1), **changes})
    errors = prediction({"persistence": 0.9, "a": 0.3, "b": 0.3, "c": 0.95})
    found = answers(replace(judged(), prediction=errors, exploitability=(held,)))["Which models can be trusted?"]
    assert (found.answer, found.tone) == ("None", "bad")
    assert f"Not trusted: {held.model} ({reason}" in found.sentence


def test_the_controller_to_use_comes_with_what_it_achieves_and_the_command_that_drives_it():
    taken = answers(judged())["Which controller to use?"]
    assert taken.answer == "a"
    assert taken.sentence.startswith("Forecast ")
    assert ") waypoints, measured 4.00 (3.93 to 4.07) on car: outside the forecast." in taken.sentence
    assert "Its claim of 10.00 is exploited." in taken.sentence
    assert "b does better on the robot, 8.10 (8.03 to 8.17), which was not known before the run." in taken.sentence
    assert taken.command == "sysid-evo drive --controller controllers/a.json --robot car"
    assert taken.tone == "bad"


def test_without_a_robot_the_answers_say_what_they_rest_on():
    taken = answers(judged(None))["Which controller to use?"]
    assert ", 9.00 (8.93 to 9.07) on the other models." in taken.sentence
    assert "Nothing was run on a robot." in taken.sentence
    assert taken.command == "sysid-evo export controllers/a.json --to c"


def test_without_a_part_the_answer_is_open_and_says_why():
    for one in headlines(report()):
        assert one.tone == "open"
        assert one.sentence
    assert (
        answers(report())["Which controller to use?"].sentence
        == "No controller was evolved, because none was asked for."
    )


def test_a_run_that_is_not_finished_is_not_called_a_failure():
    made = replace(scored(GOOD), failures=(Failure("evolve linear", WAITING),), timings={"a": 1.0, "b": 0.0})
    assert answers(made)["Which controller to use?"].sentence == (
        "No controller was evolved, because the run is not finished."
    )
    said = {one.question: one.sentence for one in verdict(made)}
    assert said["What is missing?"] == (
        "The run is not finished; repeat its command with the same --out to compute the rest."
    )
    assert "What failed?" not in said
    both = replace(made, failures=(*made.failures, Failure("fit sindy", "it broke")))
    assert "The run is not finished, and 1 of 2 steps failed;" in told(both)
    assert "repeat its command" in warnings(made)[0]


def test_the_title_names_robot_task_models_and_controllers_unless_a_title_was_chosen():
    made = judged()
    known = replace(made, settings={"robot": "car", "task": "point_to_point(horizon=60)"})
    assert page_title(known) == "car, point_to_point: 0 models, 2 controllers"
    one = replace(known, matrix=replace(known.matrix, champions=known.matrix.champions[:1]))
    assert page_title(one) == "car, point_to_point: 0 models, 1 controller"
    assert page_title(replace(known, settings={**known.settings, "title": "Made up"})) == page_title(made) == "Made up"


def test_one_line_gives_date_version_preset_seed_data_and_trials():
    settings, versions = {"preset": "quick", "seed": 3}, {"sysid-evo": "0.1.0"}
    made = replace(judged(), settings=settings, versions=versions, timings={"a": 61.4})
    made = replace(made, data=replace(made.data, test=(replace(made.data.test[0], name="another"),)))
    assert facts(replace(made, day=date(2026, 11, 24))) == (
        "24 Nov 2026 · sysid-evo 0.1.0 · preset quick · seed 3 · 8 s of data at 20 Hz, 50 % held out · 10 trials each "
        "· computed in 61 s"
    )
    assert facts(made).startswith("sysid-evo 0.1.0")


def test_failed_steps_are_counted_above_the_answers_with_the_first_reason():
    assert warnings(report()) == []
    made = replace(report(failures=2), timings={"fit": 1.0, "predict": 1.0, "run": 0.1})
    (line,) = warnings(made)
    assert line == "2 of 3 steps failed; all reasons are under This run. The first: part 0: no such package"


def test_a_model_that_fails_the_sanity_check_is_named_on_the_page_in_the_terminal_and_on_its_card():
    made = predicted(linear=0.3, sindy=0.6)
    assert warnings(made) == []
    rows = [replace(one, warning="sindy is worse") if one.name == "sindy" else one for one in made.prediction.models]
    cards = tuple(ModelSummary(name, name, "black", {}) for name in ("linear", "sindy"))
    failing = replace(made, prediction=replace(made.prediction, models=tuple(rows)), models=cards)
    assert warnings(failing) == ["sindy is worse. Forecasts leave it out if two others remain."]
    assert "sindy is worse. Forecasts leave it out if two others remain." in told(failing)
    fine, useless = models_section.section(failing).items[:2]
    assert fine.title == "linear: N 0.300, black box"
    assert useless.title == "sindy: N 0.600, worse than both no change and a linear model, black box"
    found = {one.name: one.warning for one in PredictionPart.of(failing.prediction, {}).models}
    assert found == {"persistence": "", "linear": "", "sindy": "sindy is worse"}


def test_answers_that_are_not_known_come_last():
    without = replace(judged(), exploitability=())
    assert [one.question for one in headlines(without)] == [
        "Which controller to use?",
        "Which models predict?",
        "Which models can be trusted?",
    ]
