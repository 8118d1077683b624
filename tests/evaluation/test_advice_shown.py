"""The advice is in the verdict, on the page, in the document, and comes out of a comparison and of a fit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from evaluation.advice import ModelAdvice, Remark, advice_from_json
from evaluation.experiment import Experiment
from evaluation.planning import plan_comparison
from evaluation.report import Report, advice_lines, tables, to_json, verdict
from evaluation.report.report import sections
from evaluation.running import gather_results
from sysid_evo.plan import Store, execute
from tests.fixtures.faulty_recordings import Fault, drive
from tests.fixtures.reports import prediction, printed, report

REMARKS = tuple(Remark(f"topic {i}", f"Sentence {i}.", 0.5 - 0.1 * i, {"share": 0.1}) for i in range(4))
QUESTION = "What limits linear, and what to record next?"


def advised(remarks: tuple[Remark, ...] = REMARKS) -> Report:
    made = report(prediction({"persistence": 0.9, "linear": 0.3}))
    return replace(made, advice=ModelAdvice("linear", remarks, "the test part"))


def test_the_verdict_ends_with_the_two_most_important_remarks() -> None:
    finding = verdict(advised())[-1]
    assert finding.question == QUESTION
    assert finding.answers == ("Sentence 0.", "Sentence 1.")
    assert all(finding.question != QUESTION for finding in verdict(advised(())))


def test_the_page_lists_them_all_and_says_on_what_the_model_was_judged() -> None:
    (section,) = [section for section in sections(advised()) if section.title == "Advice"]
    (sheet,) = section.items
    assert sheet.rows == tuple((one.topic, one.sentence) for one in REMARKS)  # type: ignore[union-attr]  # a sheet
    assert "Judged on the test part." in sheet.note  # type: ignore[union-attr]  # a sheet
    assert "Advice" not in [section.title for section in sections(advised(()))]


def test_the_terminal_lists_them_all_once() -> None:
    lines = printed(tables(advised()))
    assert lines.count(" - Sentence 3.") == 1
    assert advice_lines(ModelAdvice("", ())) == []
    nothing = ModelAdvice("linear", (), "the test part")
    assert printed(advice_lines(nothing)) == ["Nothing stands out that limits linear. Judged on the test part."]


def test_the_document_holds_it_and_gives_it_back() -> None:
    made = advised()
    assert advice_from_json(to_json(made)["advice"]) == made.advice
    assert to_json(report())["advice"] is None


def test_a_comparison_advises_on_the_model_that_predicts_best(tmp_path: Path) -> None:
    experiment = Experiment.of({"models": ("near=nearest_neighbour", "late=linear"), "only": "prediction"})
    comparison = plan_comparison(experiment, dataset=drive(Fault(late=6)))
    store = Store(tmp_path)
    execute(comparison.plan, store)
    made = gather_results(comparison, store)
    assert made.advice is not None
    assert made.prediction is not None
    assert made.advice.model == made.prediction.ranking(20)[0].name == "late"
    assert made.advice.judged_on == "the test part"
    assert made.advice.remarks[0].topic == "late controls"
    document = to_json(made)["prediction"]["models"][1]
    assert document["residuals"]["channels"]["speed"]["controls"]["push"]["p"] < 0.05
    assert document["residuals"]["control_lags"] == list(range(-5, 21))
    assert len(document["curve_interval"]) == 2
    assert document["episodes"][0]["name"] == "day 1[600:800]"
    assert set(document["episodes"][0]["fit_percent"]) == {"speed", "turn"}
    assert document["regions"][0]["region"]["channel"] in document["regions"][0]["words"]


def test_a_fit_with_a_test_part_advises_on_the_best_and_without_on_the_first(tmp_path: Path) -> None:
    asked = {"models": ("near=nearest_neighbour", "late=linear"), "only": "fit"}
    advice = {}
    for test in (None, ("day 3",)):
        settings = asked if test is None else {**asked, "test": test}
        comparison = plan_comparison(Experiment.of(settings), dataset=drive(Fault(late=6)))
        store = Store(tmp_path / str(test))
        execute(comparison.plan, store)
        advice[test] = store.outcome(comparison.advice).value
    assert advice[None].model == "near"
    assert advice[None].judged_on.startswith("the last quarter of each episode")
    assert advice["day 3",].model == "late"
