"""The tables of a study."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from evaluation.labels import percent
from evaluation.report.sheets import Sheet, lines, number
from evaluation.study import (
    CHOSEN,
    HINDSIGHT,
    ControllerFigures,
    Spread,
    StudyResults,
    controller_figures,
    exploit_figures,
    forecast_figures,
    prediction_figures,
)
from evaluation.study.models import HORIZONS, prediction_axes

CONTROLLER_NOTE = (
    "share: achieved on the robot, of the best that is achieved there by any controller of the study (its yardstick). "
    "worst: the lowest share of a point. claimed - achieved: what is claimed too much{unit}. "
    f"{CHOSEN}: what the program picks in each point without the robot; {HINDSIGHT}: what it would have picked knowing "
    "the outcome."
)


def controller_sheet(results: StudyResults) -> Sheet | None:
    """Every controller of every group over robots and seeds; None without one that was run on a robot."""
    figures = controller_figures(results)
    reference = next((one.name(results.study.group_axes) for one in figures if one.is_reference), None)
    compared = any(one.difference is not None for one in figures)
    axes, labels = _told_apart(results, [one.group for one in figures])
    heads = ["controller", *axes, "share", "worst", "claimed -\nachieved"]
    heads += ["reference\nminus this"] if compared else []
    rows = []
    for one in figures:
        row = [
            lines(one.controller, "(reference)" if one.is_reference else ""),
            *labels(one.group),
            spread(one.share, 2),
        ]
        row += [number(None if one.share is None else one.share.lowest, 2), spread(one.gap, 1, sign=True)]
        row += [spread(one.difference, 2, sign=True)] if compared else []
        rows.append((*row, _points(one)))
    if not rows:
        return None
    unit = _unit(results, ", in ")
    told = CONTROLLER_NOTE.format(unit=unit) + (
        f" Reference: {reference}, paired by robot and seed." if compared else ""
    )
    return Sheet("Controllers", (*heads, "points"), tuple(rows), note=f"{told} {basis(results)}")


def short_sheet(results: StudyResults) -> Sheet | None:
    """What matters of each group: what is picked, what is recommended, the best family alone; None without any."""
    figures = controller_figures(results)
    axes, labels = _told_apart(results, [one.group for one in figures])
    rows = []
    for group in dict.fromkeys(one.group for one in figures):
        own = [one for one in figures if one.group == group]
        singles = [one for one in own if one.kind == "single" and one.controller not in (CHOSEN, HINDSIGHT)]
        picked = [one for one in own if one.controller == CHOSEN]
        shown = [*picked, *(one for one in own if one.kind == "recommended" and one not in picked), *singles[:1]]
        shown = [one for one in shown if one.controller != HINDSIGHT]
        shown += [one for one in own if one.controller == HINDSIGHT]
        for one in shown:
            name = f"{one.controller} (best family alone)" if one in singles else one.controller
            worst = number(None if one.share is None else one.share.lowest, 2)
            rows.append((name, *labels(one.group), spread(one.share, 2), worst, spread(one.gap, 1, sign=True)))
    if not rows:
        return None
    heads = ("controller", *axes, "share", "worst", "claimed -\nachieved")
    unit = _unit(results, ", in ")
    note = f"share: achieved on the robot, of the best known there. claimed - achieved{unit}. Below: 95 % intervals."
    return Sheet("In short", heads, tuple(rows), note=note)


def prediction_sheet(results: StudyResults) -> Sheet | None:
    """How well each model predicts and how long a fit takes; None without a model."""
    figures = prediction_figures(results)
    if not figures:
        return None
    heads = ("model", *prediction_axes(results), *(f"N after\n{h} steps" for h in HORIZONS), "fit, s", "fits")
    rows = [
        (
            one.model,
            *one.group,
            *(spread(one.n[h], 3) for h in HORIZONS),
            number(None if one.seconds is None else one.seconds.mean, 1),
            _fits(one.fits, one.failed),
        )
        for one in figures
    ]
    note = "N: mean over channels of RMSE / standard deviation on held-out data (0 is perfect). fit: mean duration."
    return Sheet("Prediction", heads, tuple(rows), note=f"{note} {basis(results)}")


def exploit_sheet(results: StudyResults) -> Sheet | None:
    """How often the controllers evolved in each model exploit it; None where nothing was assessed."""
    figures = exploit_figures(results)
    if not figures:
        return None
    axes, labels = _told_apart(results, [one.group for one in figures])
    heads = ("model", *axes, "exploited\nin", "claim kept")
    rows = [(one.model, *labels(one.group), f"{one.exploited} of {one.judged}", spread(one.kept, 2)) for one in figures]
    note = (
        "exploited in: points in which the claims of its own controllers exceed what they achieve on the robot by a "
        "tenth and two standard errors. claim kept: share of the claim that is achieved."
    )
    return Sheet("Exploitability", heads, tuple(rows), note=f"{note} {basis(results)}")


def forecast_sheet(results: StudyResults) -> Sheet | None:
    """How well controllers are ranked and chosen without the robot; None where no point is finished."""
    figures = forecast_figures(results)
    if not figures:
        return None
    axes, labels = _told_apart(results, [one.group for one in figures])
    heads = (
        "chosen by",
        *axes,
        "rank\ncorrelation",
        "lowest",
        "loss",
        f"RMSE{_unit(results, ', ')}",
    )
    rows = [
        (
            one.figure,
            *labels(one.group),
            spread(one.correlation, 2),
            number(None if one.correlation is None else one.correlation.lowest, 2),
            spread(one.loss, 3),
            number(one.rmse, 2),
            "–" if one.inside is None else lines(percent(one.inside.mean), _between(one.inside, 2)),
            str(one.controllers),
        )
        for one in figures
    ]
    note = (
        "rank correlation with what is achieved on the robot, within a point; loss: by how much of the yardstick the "
        "controller chosen in a point falls short of the best there; intervals hold: share of the 90 % intervals of "
        "forecasts in which what is achieved lies. prediction error: of the models that a controller was evolved in."
    )
    return Sheet("Forecasts", (*heads, "intervals\nhold", "controllers"), tuple(rows), note=f"{note} {basis(results)}")


def time_sheet(results: StudyResults) -> Sheet:
    """Where time went, by kind of cell; cells that points share count once."""
    kinds = dict.fromkeys(time.kind for time in results.times)
    rows = []
    for kind in kinds:
        own = [time.seconds for time in results.times if time.kind == kind]
        rows.append((kind, len(own), sum(own)))
    rows.sort(key=lambda row: -row[2])
    rows.append(("all", len(results.times), sum(time.seconds for time in results.times)))
    text = [
        (kind, str(count), number(seconds / 60.0, 1), number(seconds / max(1, count), 2))
        for kind, count, seconds in rows
    ]
    note = "Time on one processor each, whenever it was; cells that several points need count once."
    return Sheet("Time", ("kind of cell", "cells", "min", "s a cell"), tuple(text), note=note)


def point_sheet(results: StudyResults) -> Sheet:
    """Every point: how far it is, which controller is picked there, and what it achieves."""
    chosen = {row.point: row for row in results.controllers if row.chosen}
    rows = []
    for point in results.points:
        row = chosen.get(point.name)
        state = f"{point.done} of {point.cells}" + (f", {point.failed} failed" if point.failed else "")
        picked = ("–",) * 4
        if row is not None:
            picked = (row.controller, number(row.forecast), number(row.achieved), number(row.yardstick))
        rows.append((point.name, state, *picked))
    heads = ("point", "cells", "picked", "forecast", "achieved", "yardstick")
    return Sheet("Points", heads, tuple(rows), details=len(rows) > 12)


def failure_sheet(results: StudyResults) -> Sheet | None:
    """The cells that failed, and why; None for none."""
    rows = [(one.point, one.cell, one.reason) for one in results.failures]
    return Sheet("Failures", ("point", "cell", "reason"), tuple(rows), prose=True) if rows else None


def spread(found: Spread | None, digits: int, *, sign: bool = False) -> str:
    """Return a mean, and below it its interval where there is one."""
    if found is None:
        return "–"
    mean = f"{found.mean:+.{digits}f}" if sign else number(found.mean, digits)
    return lines(mean, _between(found, digits, sign=sign))


def basis(results: StudyResults) -> str:
    """Say over how many robots and seeds intervals are, or why there are none."""
    begun = {row.point for row in results.models} | {row.point for row in results.controllers}
    robots = len({point.where for point in results.points if point.name in begun})
    seeds = len({point.seed for point in results.points if point.name in begun})
    counted = f"{robots} robot{'s' * (robots != 1)} and {seeds} seed{'s' * (seeds != 1)}"
    if robots >= 3 or (robots == 1 and seeds >= 3):
        over = "robots and seeds" if robots > 1 and seeds > 1 else "robots" if robots > 1 else "seeds of one robot"
        return f"Means and 95 % intervals over {over} ({counted}; robots are drawn, then seeds of each)."
    return f"Means over {counted}: too few for an interval, which takes three robots, or three seeds of one."


def _between(found: Spread, digits: int, *, sign: bool = False) -> str:
    if found.low is None or found.high is None:
        return ""
    low, high = (f"{end:+.{digits}f}" if sign else number(end, digits) for end in (found.low, found.high))
    return f"{low} to {high}"


def _told_apart(
    results: StudyResults, groups: Sequence[tuple[str, ...]]
) -> tuple[list[str], Callable[[tuple[str, ...]], list[str]]]:
    """Return the axes along which ``groups`` differ, and what picks the labels of a group along these."""
    places = [place for place, labels in enumerate(zip(*groups, strict=True)) if len(set(labels)) > 1]
    axes = [results.study.group_axes[place] for place in places]
    return axes, lambda group: [group[place] for place in places]


def _unit(results: StudyResults, before: str) -> str:
    units = dict.fromkeys(point.unit for point in results.points if point.unit)
    return f"{before}{next(iter(units))}" if len(units) == 1 else ""


def _points(one: ControllerFigures) -> str:
    count = 0 if one.share is None else one.share.points
    return f"{count}, {one.failed} failed" if one.failed else str(count)


def _fits(fits: int, failed: int) -> str:
    return f"{fits - failed}, {failed} failed" if failed else str(fits)
