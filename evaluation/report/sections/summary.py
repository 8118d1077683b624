"""The first screen: three answers at first sight, then the same in sentences, what is not known, and what failed."""

from __future__ import annotations

from evaluation.report.elements import Finding, Headline
from evaluation.report.sections import controllers, exploitability, prediction
from evaluation.report.sections.advice import limits_question
from evaluation.report.sections.controllers import LOOK_AT_THE_REWARD, choice_sentences, transfer_sentences
from evaluation.report.sections.controllers import open_questions as unknown
from evaluation.report.sections.prediction import prediction_sentences, scored
from evaluation.results import ComparisonResults
from evaluation.sufficiency import none_beats_rest


def headlines(report: ComparisonResults) -> tuple[Headline, ...]:
    """Return the three answers that the page begins with; that on controllers first, where none is of use."""
    found = prediction.headline(report), exploitability.headline(report), controllers.headline(report)
    useless = report.matrix is not None and none_beats_rest(report.matrix)
    return (found[2], *found[:2]) if useless else found


SAID = 2
"""Remarks of the advice that the verdict repeats."""


def verdict(report: ComparisonResults) -> tuple[Finding, ...]:
    """Answer which models predict, which controllers transfer, what to use, and what stays open."""
    findings = []
    if tells_nothing(report):
        both = "" if report.matrix is None else " and no controller could be run"
        said = f"Nothing: no model could be scored{both}. Look at the failures and notes, or record more data."
        compared = report.prediction is not None or report.matrix is not None
        findings.append(Finding("What was found?", (said if compared else "Nothing was compared.",)))
    if report.matrix is not None and none_beats_rest(report.matrix):
        findings.append(Finding("Is there anything to choose?", (LOOK_AT_THE_REWARD,)))
    if report.prediction is not None:
        findings.append(Finding("Which models predict?", prediction_sentences(report.prediction)))
    if report.matrix is not None:
        findings.append(Finding("Which controllers transfer?", transfer_sentences(report.matrix, report.transfer)))
        if report.transfer is not None and not all(cell.failed for cell in report.matrix.cells.values()):
            findings.append(Finding("What to use?", choice_sentences(report)))
            if open_questions := unknown(report.transfer):
                findings.append(Finding("What is not known?", open_questions))
    if report.advice is not None and report.advice.remarks:
        remarks = tuple(remark.sentence for remark in report.advice.remarks[:SAID])
        findings.append(Finding(limits_question(report.advice), remarks))
    if report.all_failures:
        count = len(report.all_failures)
        findings.append(
            Finding("What failed?", (f"{count} {'part' if count == 1 else 'parts'}; the reasons are listed below.",))
        )
    return tuple(findings)


def tells_nothing(report: ComparisonResults) -> bool:
    """Whether no model has a score and no controller was run anywhere."""
    found, matrix = report.prediction, report.matrix
    has_score = found is not None and any(scored(found, horizon) for horizon in found.horizons)
    return not has_score and (matrix is None or all(cell.failed for cell in matrix.cells.values()))
