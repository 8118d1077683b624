"""What a report says at first sight: which models predict, which can be trusted, which controller to take."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from evaluation.exploitability import ModelExploitability
from evaluation.labels import few
from evaluation.report.contents import Report
from evaluation.report.forecasting import forecast_text
from evaluation.report.overview import drive_command
from evaluation.report.predicting import horizon_name, main_horizon, predicts, scored
from evaluation.report.sheets import three_digits
from evaluation.report.transferring import sized
from evaluation.transfer import ControllerSummary, Estimate

Tone = Literal["good", "bad", "open"]
NAMED = 4
"""Names in one answer."""


@dataclass(frozen=True)
class Headline:
    """One question, its answer in a few words, a sentence on it, and the command that acts on it, if there is one.

    The ``tone`` is good news, bad news, or that it stays open.
    """

    question: str
    answer: str
    sentence: str
    tone: Tone
    command: str = ""


def headlines(report: Report) -> tuple[Headline, ...]:
    """Return the three answers that the page begins with."""
    return _predicting(report), _trusted(report), _taken(report)


def _predicting(report: Report) -> Headline:
    question, prediction = "Which models predict?", report.prediction
    if prediction is None:
        return Headline(question, "Not known", "No prediction was made.", "open")
    horizon = main_horizon(prediction)
    models = scored(prediction, horizon) if prediction.horizons else ()
    if not models:
        return Headline(question, "Not known", "No model has a score; the notes and failures say why.", "open")
    best = models[0]
    score = best.score(horizon)
    assert score is not None
    size = f"N {three_digits(score.n)} ({three_digits(score.interval.low)} to {three_digits(score.interval.high)})"
    where = horizon_name(prediction, horizon)
    good = [model.name for model in models if predicts(prediction, model, horizon)]
    if not good:
        return Headline(question, "None", f"The lowest error, {size} at {where}, is that of {best.name}.", "bad")
    compared = {other.name: prediction.compare(other.name, best.name, horizon) for other in models[1:]}
    equal = [name for name in good if (found := compared.get(name)) is not None and not found.significant]
    leaders = [best.name, *equal]
    more = f"; {len(good)} of {len(models)} predict" if len(models) > 1 else ""
    alike = ", no significant difference between them" if len(leaders) > 1 else ""
    return Headline(question, few(leaders, NAMED), f"Best at {where}: {size}{alike}{more}.", "good")


def _trusted(report: Report) -> Headline:
    question, found = "Which models can be trusted?", report.exploitability
    if report.matrix is None or report.transfer is None:
        return Headline(question, "Not known", "No controller was evolved, so none could exploit a model.", "open")
    judged = [model for model in found if model.exploited is not None]
    if not judged:
        reason = "There is nowhere else to run their controllers." if found else "No model was assessed."
        return Headline(question, "Not known", reason, "open")
    kept, lost = [m for m in judged if not m.exploited], [m for m in judged if m.exploited]
    where = "on the robot" if any(model.achieved is not None for model in judged) else "on the other models"
    told = [f"{m.model} ({_claim(m.claimed, m.elsewhere)})" for m in sorted(lost, key=_loss)]
    if not kept:
        return Headline(question, "None", f"Every one is exploited, {where}: {few(told, NAMED)}.", "bad")
    exploited = f" Exploited: {few(told, NAMED)}." if lost else ""
    names = "All of them" if not lost and len(kept) > 1 else few([model.model for model in kept], NAMED)
    several = [c for c in report.transfer.controllers if c.exploited and len(c.against) > 1]
    together = [f"{c.name} ({_claim(c.claimed, c.elsewhere)})" for c in several]
    jointly = f" Exploited together: {few(together, NAMED)}." if together else ""
    return Headline(question, names, f"What is claimed in them holds {where}.{exploited}{jointly}", "good")


def _taken(report: Report) -> Headline:
    question, summary = "Which controller to take?", report.transfer
    if summary is None:
        return Headline(question, "None", "No controller was evolved.", "open")
    if summary.pick is None:
        return Headline(question, "Not known", "No controller can be judged by models of other families.", "open")
    pick = summary.controller(summary.pick)
    command = drive_command(report, pick.name) or ""
    return Headline(question, pick.name, _worth(pick, report), "bad" if pick.exploited else "good", command)


def _worth(pick: ControllerSummary, report: Report) -> str:
    assert report.matrix is not None
    unit = f" {report.matrix.unit}" if report.matrix.unit else ""
    shown = pick.shown
    claim = f"Claims {sized(shown['claimed'])}{unit}" if "claimed" in shown else ""
    found = report.forecasts.get(pick.name)
    claim += "" if found is None else f", forecast {forecast_text(found)}"
    if "achieved" in shown:
        return f"{claim}, achieves {sized(shown['achieved'])} on the robot.{_better(pick, report)}"
    if "others" in shown:
        return f"{claim}, reaches {sized(shown['others'])} on the other models. Nothing was run on the robot."
    return f"{claim}. Nothing was run on the robot."


def _better(pick: ControllerSummary, report: Report) -> str:
    """Say which controller from models does clearly better on the robot than the one that was chosen without it."""
    assert report.transfer is not None
    others = [c for c in report.transfer.controllers if c.against and not c.on_robot and c.name != pick.name]
    reached = [(c.shown["achieved"], c.name) for c in others if "achieved" in c.shown]
    best = max(reached, key=lambda one: one[0].value, default=None)
    if best is None or not best[0].low > pick.shown["achieved"].high:
        return ""
    return f" {best[1]} does better there: {sized(best[0])}."


def _claim(claimed: Estimate | None, achieved: Estimate | None) -> str:
    assert claimed is not None
    assert achieved is not None
    return f"claims {claimed.value:.1f}, achieves {achieved.value:.1f}"


def _loss(model: ModelExploitability) -> float:
    return 0.0 if model.gap is None else -model.gap.value
