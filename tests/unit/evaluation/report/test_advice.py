"""The advice is in the verdict, on the page, in the document, and comes out of a comparison and of a fit."""

from dataclasses import replace

import pytest

from evaluation.advice.evidence import ModelAdvice, Remark
from evaluation.experiment import Experiment
from evaluation.planning import plan_comparison
from evaluation.report.report import sections, tables, to_json
from evaluation.report.sections.advice import advice_lines
from evaluation.report.sections.summary import verdict
from evaluation.storage import from_plain
from sysid_evo.plan import Store, execute
from tests.fixtures.faulty_recordings import Fault, drive
from tests.fixtures.reports import prediction, printed, report

REMARKS = tuple(Remark(f"topic {i}", f"Sentence {i}.", 0.5 - 0.1 * i, {"share": 0.1}) for i in range(4))
QUESTION = "What limits linear, and what to record next?"


def advised(remarks=REMARKS):
    made = report(prediction({"persistence": 0.9, "linear": 0.3}))
    return replace(made, advice=ModelAdvice("linear", "the test part", remarks))


def test_the_verdict_ends_with_the_two_most_important_remarks():
    finding = verdict(advised())[-1]
    assert finding.question == QUESTION
    assert finding.sentences == ("Sentence 0.", "Sentence 1.")
    assert all(finding.question != QUESTION for finding in verdict(advised(())))


def test_the_page_lists_them_all_and_says_on_what_the_model_was_judged():
    (section,) = [section for section in sections(advised()) if section.link == "Next recording"]
    (sheet,) = section.items
    assert sheet.rows == tuple((one.topic, one.sentence) for one in REMARKS)
    assert "Evaluated on the test part." in sheet.note
    assert section.title == QUESTION.rstrip("?")
    assert "Next recording" not in [section.link for section in sections(advised(()))]


def test_the_terminal_lists_them_all_once():
    lines = printed(tables(advised()))
    assert lines.count(" - Sentence 3.") == 1
    assert advice_lines(ModelAdvice("")) == []
    nothing = ModelAdvice("linear", "the test part")
    assert printed(advice_lines(nothing)) == ["No clear limit of linear was found. Evaluated on the test part."]


def test_the_document_holds_it_and_gives_it_back():
    made = advised()
    assert from_plain(ModelAdvice, to_json(made)["advice"]) == made.advice
    assert to_json(report())["advice"] is None


@pytest.mark.parametrize(
    ("test", "judged_on"),
    [
        pytest.param({}, "the last quarter of each episode", id="without a test part"),
        pytest.param({"test": ("day 3",)}, "the test part", id="with a test part"),
    ],
)
def test_a_fit_advises_on_its_most_accurate_model(test, judged_on, tmp_path):
    experiment = Experiment.of({"models": ("near=nearest_neighbour", "late=linear"), "stop_after": "fit", **test})
    comparison = plan_comparison(experiment, dataset=drive(Fault(late=6), steps=400))
    store = Store(tmp_path)
    execute(comparison.plan, store)
    advice = store.outcome(comparison.advice).value
    assert advice.model == "late"  # the second one
    assert advice.evaluated_on.startswith(judged_on)
