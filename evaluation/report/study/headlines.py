"""What a study says at first sight: which controller to trust, whether forecasts hold, which models predict."""

from __future__ import annotations

from evaluation.labels import percent
from evaluation.report.headlines import Headline
from evaluation.report.study.tables import basis
from evaluation.report.verdict import Finding
from evaluation.study import (
    CHOSEN,
    HINDSIGHT,
    ControllerFigures,
    Spread,
    StudyResults,
    controller_figures,
    forecast_figures,
    prediction_figures,
)
from evaluation.study.study import group_name


def headlines(results: StudyResults) -> tuple[Headline, ...]:
    """Return the three answers that the page begins with."""
    return _achieving(results), _forecasting(results), _predicting(results)


def findings(results: StudyResults) -> list[Finding]:
    """Say what the numbers rest on: points, robots and seeds, yardsticks, and what failed or is missing."""
    finished, all_points = len(results.finished), len(results.points)
    done = [f"{all_points} points. {basis(results)}"]
    if finished < all_points:
        missing = sum(point.missing for point in results.points)
        first = next(point.name for point in results.points if not point.finished)
        done.append(
            f"{all_points - finished} of {all_points} points are not finished ({missing} cells are missing, the first "
            f"in {first}): the figures are those of what is there."
        )
    if results.failures:
        done.append(f"{len(results.failures)} cells failed; the reasons are listed below.")
    yardsticks = {}
    for row in results.controllers:
        if row.yardstick is not None:
            yardsticks[results.point(row.point).where] = row.yardstick
    found = [Finding("What do the numbers rest on?", tuple(done))]
    if yardsticks:
        told = ", ".join(f"{robot} {value:.1f}" for robot, value in yardsticks.items())
        found.append(Finding("What is possible?", (f"Best achieved on each robot, its yardstick: {told}.",)))
    return found


def _achieving(results: StudyResults) -> Headline:
    question = "Which controllers hold on the robot?"
    figures = [one for one in controller_figures(results) if one.share is not None and one.controller != HINDSIGHT]
    axes = results.study.group_axes
    named = [one for one in figures if one.controller != CHOSEN and one.kind != "robot"]
    if not named:
        return Headline(question, "Not known", "No controller was run on a robot.", "open")
    best = max(named, key=_mean_share)
    assert best.share is not None
    alone = [one for one in named if one.kind == "single"]
    told = f"It achieves {_shares(best.share)} of the yardstick, {percent(best.share.lowest)} at worst."
    if alone and best.kind != "single":
        other = max(alone, key=_mean_share)
        assert other.share is not None
        told += f" The best family alone: {other.name(axes)}, {_shares(other.share)}"
        told += f", {percent(other.share.lowest)} at worst."
    return Headline(question, best.name(axes), told, "good")


def _forecasting(results: StudyResults) -> Headline:
    question = "Can one choose without the robot?"
    figures = forecast_figures(results)
    by_forecast = [one for one in figures if one.figure == "forecast" and one.correlation is not None]
    if not by_forecast:
        return Headline(question, "Not known", "No finished point has controllers with forecasts.", "open")
    one = by_forecast[0]
    claim = next((other for other in figures if other.group == one.group and other.figure == "claim"), None)
    assert one.correlation is not None
    answer = f"Rank correlation {one.correlation.mean:.2f}"
    told = f"Within a point, of the forecast with what is achieved{_in_group(results, one.group)}."
    if one.loss is not None and claim is not None and claim.loss is not None:
        told += (
            f" Choosing by it loses {percent(one.loss.mean)} of the yardstick, choosing by the claim "
            f"{percent(claim.loss.mean)}."
        )
    if one.inside is not None:
        told += f" {percent(one.inside.mean)} of the 90 % intervals hold."
    return Headline(question, answer, told, "good" if one.correlation.mean > 0.5 else "bad")


def _predicting(results: StudyResults) -> Headline:
    question = "Which models predict?"
    figures = [one for one in prediction_figures(results) if one.n[20] is not None]
    if not figures:
        return Headline(question, "Not known", "No prediction was made.", "open")
    told = [f"{one.model} {n.mean:.3f}" for one in figures[:4] if (n := one.n[20]) is not None]
    return Headline(question, figures[0].model, f"N after 20 steps: {', '.join(told)}.", "good")


def _mean_share(one: ControllerFigures) -> float:
    return -1e9 if one.share is None else one.share.mean


def _shares(found: Spread) -> str:
    if found.low is None or found.high is None:
        return percent(found.mean)
    return f"{percent(found.mean)} ({percent(found.low)} to {percent(found.high)})"


def _in_group(results: StudyResults, group: tuple[str, ...]) -> str:
    name = group_name(results.study.group_axes, group)
    return f" ({name})" if name else ""
