"""The first screen: title, facts, the three answers with a figure; the answers in sentences; failures."""

from __future__ import annotations

from evaluation.formatting import percent
from evaluation.report.elements import Answer
from evaluation.report.sections import controllers, exploitability, prediction
from evaluation.report.sections.advice import limits_question
from evaluation.report.sections.controllers import open_questions
from evaluation.report.sections.prediction import scored
from evaluation.results import ComparisonResults
from sysid_evo.plan.store import WAITING


def page_title(report: ComparisonResults) -> str:
    """Return robot, task and numbers of models and controllers; the title alone if no task was named."""
    settings = report.settings
    task = str(settings.get("task") or "").partition("(")[0]
    if settings.get("title") or not task:
        return report.title
    made = [] if report.matrix is None else [one for one in report.matrix.champions if one.against]
    numbers = {"model": len(report.models), "controller": len(made)}
    counts = [f"{count} {one}{'' if count == 1 else 's'}" for one, count in numbers.items() if count or one == "model"]
    return f"{settings.get('robot') or report.data.name or 'own data'}, {task}: {', '.join(counts)}"


def facts(report: ComparisonResults) -> str:
    """Return one line on how the run was made: day of the run, version, preset, seed, data, trials, computing time."""
    data, settings = report.data, report.settings
    parts = [part for part in (data.training, () if data.test == data.training else data.test) if part]
    seconds = [sum(episode.duration for episode in part) for part in parts]
    length = f"{sum(seconds) / 60.0:.2g} min" if sum(seconds) >= 60.0 else f"{sum(seconds):.0f} s"
    recorded = f"{length} of data at {1.0 / data.system.dt:.3g} Hz"
    trials = [] if report.matrix is None else [cell.trials for cell in report.matrix.cells.values()]
    spent = sum(report.timings.values())
    wording = (
        "" if report.day is None else f"{report.day.day} {report.day:%b %Y}",
        f"sysid-evo {report.versions['sysid-evo']}" if "sysid-evo" in report.versions else "",
        f"preset {settings['preset']}" if "preset" in settings else "",
        f"seed {settings['seed']}" if "seed" in settings else "",
        f"{recorded}, {percent(seconds[1] / sum(seconds))} held out" if len(seconds) > 1 else recorded,
        f"{max(trials)} trials each" if any(trials) else "",
        f"computed in {spent:.0f} s" if spent >= 1.0 else "",
    )
    return " \u00b7 ".join(filter(None, wording))


def warnings(report: ComparisonResults) -> list[str]:
    """Return sentences on a badly known reward, models that fail the sanity check, and steps that failed or miss."""
    failures, found = report.all_failures, [*filter(None, [report.task_warning]), *report.model_warnings]
    if not failures:
        return found
    first = failures[0]
    reason = first.reason.splitlines()[0] if first.reason else "failed"
    return [*found, f"{_failed(report)}; all reasons are under This run. The first: {first.step}: {reason}"]


def _failed(report: ComparisonResults) -> str:
    count, steps = sum(failure.reason != WAITING for failure in report.all_failures), len(report.timings)
    if not report.finished:
        failed = f", and {count} of {steps} steps failed" if count else ""
        return f"the run is not finished{failed}; repeat its command with the same --out to compute the rest"
    of = f"{count} of {steps} steps" if steps >= count else "1 step" if count == 1 else f"{count} steps"
    return f"{of} failed"


def headlines(report: ComparisonResults) -> tuple[Answer, ...]:
    """Return the three answers at the top of the page, those that are not known last."""
    found = controllers.headline(report), exploitability.headline(report), prediction.headline(report)
    return tuple(sorted(found, key=lambda one: one.tone == "open"))


SAID = 2
"""Number of remarks of the advice that the terminal prints."""


def verdict(report: ComparisonResults) -> tuple[Answer, ...]:
    """Return the answers, what is not known, what limits the best model, and what failed, for a terminal."""
    findings = list(headlines(report))
    if is_empty(report):
        both = "" if report.matrix is None else " and no controller could be run"
        wording = f"Nothing: no model could be scored{both}. Look at the failures and notes, or record more data."
        compared = report.prediction is not None or report.matrix is not None
        findings = [Answer("What was found?", "", (wording if compared else "Nothing was compared.",))]
    elif report.transfer is not None and (unknown := open_questions(report.transfer)):
        findings.append(Answer("What is not known?", "", unknown))
    if report.task_warning:
        findings.insert(0, Answer("Is the reward known?", "", (report.task_warning,), "warn"))
    if report.model_warnings:
        findings.append(Answer("Which models are left out?", "", report.model_warnings, "warn"))
    if report.advice is not None and report.advice.remarks:
        remarks = tuple(remark.sentence for remark in report.advice.remarks[:SAID])
        findings.append(Answer(limits_question(report.advice), "", remarks))
    if report.all_failures:
        sentence = _failed(report)
        question = "What failed?" if report.finished else "What is missing?"
        findings.append(Answer(question, "", (f"{sentence[0].upper()}{sentence[1:]}.",), "warn"))
    return tuple(findings)


def is_empty(report: ComparisonResults) -> bool:
    """Whether no model has a score and no controller was run anywhere."""
    found, matrix = report.prediction, report.matrix
    has_score = found is not None and any(scored(found, horizon) for horizon in found.horizons)
    return not has_score and (matrix is None or all(cell.failed for cell in matrix.cells.values()))
