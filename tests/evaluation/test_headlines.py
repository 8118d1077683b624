"""The three answers that the page begins with."""

from __future__ import annotations

from dataclasses import replace

from evaluation.report import Report
from evaluation.report.elements import Headline
from evaluation.report.sections.summary import headlines
from evaluation.transfer import Estimate
from tests.fixtures.reports import exploited, matrix, prediction, report

FITNESS = {"a": {"a": 10.0, "b": 9.0, "car": 4.0}, "b": {"a": 8.0, "b": 8.0, "car": 8.1}}


def made(robot: str | None = "car") -> Report:
    fitness = (
        FITNESS if robot else {row: {c: v for c, v in cells.items() if c != "car"} for row, cells in FITNESS.items()}
    )
    return replace(
        report(prediction({"persistence": 0.9, "a": 0.300, "b": 0.301, "c": 0.5}), matrix(fitness, robot=robot)),
        exploitability=(exploited(model="a"), exploited(model="b", gap=Estimate(0.1, 0.1))),
        controllers={"a": "controllers/a.json", "b": "controllers/b.json"},
        settings={"robot": robot},
    )


def answers(of: Report) -> dict[str, Headline]:
    return {one.question: one for one in headlines(of)}


def test_the_best_models_that_do_not_differ_are_named_with_how_many_predict() -> None:
    best = answers(made())["Which models predict?"]
    assert best.answer == "a, b"
    assert best.tone == "good"
    assert "N 0.300 (0.280 to 0.320), no significant difference between them; 3 of 3 predict." in best.sentence


def test_a_comparison_in_which_nothing_predicts_says_so() -> None:
    worst = answers(report(prediction({"persistence": 0.5, "a": 1.2})))["Which models predict?"]
    assert (worst.answer, worst.tone) == ("None", "bad")
    assert "is that of a." in worst.sentence


def test_models_whose_claims_hold_can_be_trusted_and_exploited_ones_are_named() -> None:
    trusted = answers(made())["Which models can be trusted?"]
    assert (trusted.answer, trusted.tone) == ("b", "good")
    assert "Exploited: a (claims 10.00, achieves 4.00)." in trusted.sentence
    none = answers(replace(made(), exploitability=(exploited(model="a"),)))["Which models can be trusted?"]
    assert (none.answer, none.tone) == ("None", "bad")


def test_the_controller_to_take_comes_with_what_it_achieves_and_the_command_that_drives_it() -> None:
    taken = answers(made())["Which controller to take?"]
    assert taken.answer == "a"
    assert taken.sentence.startswith("Claims 10.00 (9.94 to 10.06) waypoints, forecast ")
    assert taken.sentence.endswith(
        "), achieves 4.00 (3.94 to 4.06) on the robot. b does better there: 8.10 (8.04 to 8.16)."
    )
    assert taken.command == "sysid-evo drive --controller controllers/a.json --robot car"
    assert taken.tone == "bad"


def test_without_a_robot_the_answers_say_what_they_rest_on() -> None:
    taken = answers(made(None))["Which controller to take?"]
    assert taken.sentence.endswith("reaches 9.00 (8.94 to 9.06) on the other models. Nothing was run on the robot.")
    assert taken.command == "sysid-evo export controllers/a.json --to c"


def test_without_a_part_the_answer_is_open_and_says_why() -> None:
    for one in headlines(report()):
        assert one.tone == "open"
        assert one.sentence
    assert answers(report())["Which controller to take?"].sentence == "No controller was evolved."
