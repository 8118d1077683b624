"""The report of a study: its page, document and terminal form; answers, tables and figures over robots and seeds."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import RenderableType
from rich.text import Text

from evaluation.formatting import ERRORS_WIDE, by_error, lines, number, percent, three_digits
from evaluation.plots import MeanAndInterval, plot_spreads
from evaluation.report.elements import (
    NARROW,
    WIDE,
    Answer,
    Drawing,
    DrawingPair,
    FigureElement,
    Page,
    Section,
    TableElement,
    present,
)
from evaluation.report.render.html import page_of
from evaluation.report.render.markdown import story_to_markdown
from evaluation.report.render.terminal import answer_lines, table_lines
from evaluation.report.save import json_text, write_text
from evaluation.storage import plain
from evaluation.study.figures import (
    CHOSEN,
    HINDSIGHT,
    HORIZONS,
    ControllerFigures,
    Spread,
    controller_figures,
    exploit_figures,
    forecast_figures,
    prediction_axes,
    prediction_figures,
)
from evaluation.study.results import StudyResults
from evaluation.study.study import group_name, label_of
from sysid_evo.validation.estimates import CONFIDENCE

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def study_page(results: StudyResults) -> Page:
    """Return the page of a study."""
    controllers = present(normalised_picture(results), controller_sheet(results), gap_picture(results))
    models = present(error_picture(results), prediction_sheet(results), exploit_sheet(results))
    forecasts = present(forecast_sheet(results))
    failed = [(one.point, one.cell, one.reason) for one in results.failures]
    sections = [
        Section("Controllers", controllers, absent=[] if controllers else ["No controller was run on a robot."]),
        Section("Models", models, absent=[] if models else ["No model is fitted yet."]),
        Section(
            "Forecasts", forecasts, absent=[] if forecasts else ["No finished point has controllers with forecasts."]
        ),
        Section("Time", [time_sheet(results)]),
        Section("Points", [point_sheet(results)]),
        *(
            [Section("Failures", [TableElement("Failures", ("point", "cell", "reason"), tuple(failed), prose=True)])]
            if failed
            else []
        ),
        Section("Settings", [settings_sheet(results)], background=True),
    ]
    answers = _achieving(results), _forecasting(results), _predicting(results)
    return Page(results.study.title, answers, findings(results), summary_table(results), sections)


DOCUMENT, MARKDOWN, PAGE = "study.json", "study.md", "study.html"


def save_study(results: StudyResults, folder: str | Path) -> tuple[Path, ...]:
    """Write ``study.json``, ``study.md`` and ``study.html`` into ``folder`` and return their paths."""
    page = study_page(results)
    unfolded = [
        replace(one, items=[item for item in one.items if not (isinstance(item, TableElement) and item.details)])
        for one in page.sections
    ]
    short = replace(page, sections=[one for one in unfolded if one.items or one.absent])
    texts = {
        DOCUMENT: json_text(study_document(results)),
        MARKDOWN: story_to_markdown(short),
        PAGE: page_of(page),
    }
    return tuple(write_text(Path(folder) / name, text) for name, text in texts.items())


def study_brief(results: StudyResults, *, verbose: bool = False) -> list[RenderableType]:
    """Return the answers and the short table; with ``verbose`` every table that the page does not fold away."""
    page = study_page(results)
    parts: list[RenderableType] = [
        Text(page.title, style="bold"),
        *answer_lines([Answer(one.question, "", (f"{one.answer}. {one.sentence}",)) for one in page.headlines]),
        *answer_lines(page.findings),
    ]
    short = page.overview or prediction_sheet(results)
    parts += [] if short is None else table_lines(short)
    if verbose:
        for section in page.sections:
            for sheet in section.sheets:
                parts += [] if sheet.details else table_lines(sheet)
    return parts


def _achieving(results: StudyResults) -> Answer:
    question = "Which controllers work on the robot?"
    figures = [one for one in controller_figures(results) if one.normalised is not None and one.controller != HINDSIGHT]
    axes = results.study.group_axes
    named = [one for one in figures if one.controller != CHOSEN and one.kind != "robot"]
    if not named:
        return Answer(question, "Not known", ("No controller was run on a robot.",))
    best = max(named, key=_mean_of)
    assert best.normalised is not None
    alone = [one for one in named if one.kind == "single"]
    lowest = percent(best.normalised.lowest)
    text = f"It achieves {_percent_of(best.normalised)} of the best known fitness, {lowest} in its worst point."
    if alone and best.kind != "single":
        other = max(alone, key=_mean_of)
        assert other.normalised is not None
        text += f" The best family alone: {other.name(axes)}, {_percent_of(other.normalised)}"
        text += f", {percent(other.normalised.lowest)} in its worst point."
    return Answer(question, best.name(axes), (text,), "good")


def _mean_of(one: ControllerFigures) -> float:
    return -1e9 if one.normalised is None else one.normalised.mean


def _percent_of(found: Spread) -> str:
    if found.low is None or found.high is None:
        return percent(found.mean)
    return f"{percent(found.mean)} ({percent(found.low)} to {percent(found.high)})"


def _forecasting(results: StudyResults) -> Answer:
    question = "Can a controller be chosen without the robot?"
    figures = forecast_figures(results)
    by_forecast = [one for one in figures if one.figure == "forecast" and one.correlation is not None]
    if not by_forecast:
        return Answer(question, "Not known", ("No finished point has controllers with forecasts.",))
    one = by_forecast[0]
    claim = next((other for other in figures if other.group == one.group and other.figure == "claim"), None)
    assert one.correlation is not None
    answer = f"Rank correlation {one.correlation.mean:.2f}"
    group = group_name(results.study.group_axes, one.group)
    text = f"Between forecast and achieved fitness, within a point{group and f' ({group})'}."
    if one.loss is not None and claim is not None and claim.loss is not None:
        text += (
            f" The choice by forecast loses {percent(one.loss.mean)} of the best known fitness, the choice by claim "
            f"{percent(claim.loss.mean)}."
        )
    if one.inside is not None:
        text += f" {percent(one.inside.mean)} of the 90 % intervals contain the achieved fitness."
    return Answer(question, answer, (text,), "good" if one.correlation.mean > 0.5 else "bad")


def _predicting(results: StudyResults) -> Answer:
    question = "Which models predict?"
    figures = [one for one in prediction_figures(results) if one.n[20] is not None]
    if not figures:
        return Answer(question, "Not known", ("No prediction was made.",))
    text = [f"{one.model} {n.mean:.3f}" for one in figures[:4] if (n := one.n[20]) is not None]
    return Answer(question, figures[0].model, (f"N after 20 steps: {', '.join(text)}.",), "good")


def findings(results: StudyResults) -> list[Answer]:
    """Return the basis of the numbers: points, robots and seeds, best known fitness, failed and missing cells."""
    finished, all_points = len(results.finished), len(results.points)
    done = [f"{all_points} points. {_basis(results)}"]
    if finished < all_points:
        missing = sum(point.missing for point in results.points)
        first = next(point.name for point in results.points if not point.finished)
        done.append(
            f"{all_points - finished} of {all_points} points are not finished ({missing} cells are missing, the first "
            f"in {first}): all figures are of finished cells."
        )
    if results.failures:
        done.append(f"{len(results.failures)} cells failed; the reasons are listed below.")
    best_known = {}
    for row in results.controllers:
        if row.best_known is not None:
            best_known[results.point(row.point).where] = row.best_known
    found = [Answer("What are the figures based on?", "", tuple(done))]
    if best_known:
        text = ", ".join(f"{robot} {three_digits(value)}" for robot, value in best_known.items())
        found.append(Answer("What is possible?", "", (f"Best known fitness on each robot: {text}.",)))
    return found


def summary_table(results: StudyResults) -> TableElement | None:
    """The main rows of each group: the chosen controller, the polished one, the best single family; None if empty."""
    figures = controller_figures(results)
    axes, labels = differing_axes(results, [one.group for one in figures])
    rows = []
    for group in dict.fromkeys(one.group for one in figures):
        own = [one for one in figures if one.group == group]
        singles = [one for one in own if one.kind == "single" and one.controller not in (CHOSEN, HINDSIGHT)]
        picked = [one for one in own if one.controller == CHOSEN]
        shown = [*picked, *(one for one in own if one.kind == "polished" and one not in picked), *singles[:1]]
        shown = [one for one in shown if one.controller != HINDSIGHT]
        shown += [one for one in own if one.controller == HINDSIGHT]
        for one in shown:
            name = f"{one.controller} (best family alone)" if one in singles else one.controller
            worst = number(None if one.normalised is None else one.normalised.lowest, 2)
            rows.append((name, *labels(one.group), _spread(one.normalised, 2), worst, _spread(one.gap, sign=True)))
    if not rows:
        return None
    heads = ("controller", *axes, "normalised", "lowest", "claimed -\nachieved")
    unit = _unit(results, ", in {}")
    note = (
        "normalised: achieved fitness divided by the best known on that robot, both minus that of controls at rest. "
        f"lowest: that of the worst point. claimed - achieved{unit}. Below: 95 % intervals."
    )
    return TableElement("In short", heads, tuple(rows), note=note)


def controller_sheet(results: StudyResults) -> TableElement | None:
    """Every controller of every group over robots and seeds; None without one that was run on a robot."""
    figures = controller_figures(results)
    reference = next((one.name(results.study.group_axes) for one in figures if one.is_reference), None)
    compared = any(one.difference is not None for one in figures)
    axes, labels = differing_axes(results, [one.group for one in figures])
    heads = ["controller", *axes, "normalised", "interquartile\nmean", "lowest", "claimed -\nachieved"]
    heads += ["reference\nminus this", "probability of\nimprovement"] if compared else []
    rows = []
    for one in figures:
        row = [
            lines(one.controller, "(reference)" if one.is_reference else ""),
            *labels(one.group),
            _spread(one.normalised, 2),
        ]
        lowest = None if one.normalised is None else one.normalised.lowest
        row += [number(one.middle, 2), number(lowest, 2), _spread(one.gap, sign=True)]
        row += [_spread(one.difference, 2, sign=True), percent(one.improvement)] if compared else []
        points = 0 if one.normalised is None else one.normalised.points
        rows.append((*row, f"{points}, {one.failed} failed" if one.failed else str(points)))
    if not rows:
        return None
    paired = f" Reference: {reference}, paired by robot and seed; improvement: of it over this." if compared else ""
    note = (
        "normalised: achieved fitness divided by the best known, which is the best that any controller of the study "
        "achieves on that robot, both minus that of controls at rest. lowest: that of the worst point. "
        f"claimed - achieved{_unit(results, ', in {}')}. {CHOSEN}: the controller chosen in each point without the "
        f"robot; {HINDSIGHT}: the best one there.{paired} {_basis(results)}"
    )
    return TableElement("Controllers", (*heads, "points"), tuple(rows), note=note)


def prediction_sheet(results: StudyResults) -> TableElement | None:
    """Prediction error and time of a fit of each model; None without a model."""
    figures = prediction_figures(results)
    if not figures:
        return None
    heads = ("model", *prediction_axes(results), *(f"N after\n{h} steps" for h in HORIZONS), "fit, s", "fits")
    rows = [
        (
            one.model,
            *one.group,
            *(_spread(one.n[h], 3) for h in HORIZONS),
            number(None if one.seconds is None else one.seconds.mean, 1),
            f"{one.fits - one.failed}, {one.failed} failed" if one.failed else str(one.fits),
        )
        for one in figures
    ]
    note = "N: mean over channels of RMSE / standard deviation on held-out data (0 is perfect). fit: mean duration."
    return TableElement("Prediction", heads, tuple(rows), note=f"{note} {_basis(results)}")


def exploit_sheet(results: StudyResults) -> TableElement | None:
    """How often the controllers evolved in each model exploit it; None if nothing was assessed."""
    figures = exploit_figures(results)
    if not figures:
        return None
    axes, labels = differing_axes(results, [one.group for one in figures])
    heads = ("model", *axes, "exploited\nin", "claim kept")
    rows = [
        (one.model, *labels(one.group), f"{one.exploited} of {one.assessed}", _spread(one.kept, 2)) for one in figures
    ]
    note = (
        "exploited in: points in which the claims of its own controllers exceed their fitness on the robot by a tenth "
        "and by two standard errors. claim kept: share of the claim that is achieved."
    )
    return TableElement("Exploitability", heads, tuple(rows), note=f"{note} {_basis(results)}")


def forecast_sheet(results: StudyResults) -> TableElement | None:
    """How well controllers are ranked and chosen without the robot; None if no point is finished."""
    figures = forecast_figures(results)
    if not figures:
        return None
    axes, labels = differing_axes(results, [one.group for one in figures])
    heads = (
        "chosen by",
        *axes,
        "rank\ncorrelation",
        "lowest",
        "loss",
        f"RMSE{_unit(results, ', {}')}",
    )
    rows = [
        (
            one.figure,
            *labels(one.group),
            _spread(one.correlation, 2),
            number(None if one.correlation is None else one.correlation.lowest, 2),
            _spread(one.loss, 3),
            three_digits(one.rmse),
            "–" if one.inside is None else lines(percent(one.inside.mean), _between(one.inside, 2)),
            str(one.controllers),
        )
        for one in figures
    ]
    note = (
        "rank correlation: with fitness on the robot, within a point. loss: normalised fitness of the best controller "
        "of a point minus that of the chosen one. coverage: share of the 90 % intervals of forecasts that contain the "
        "fitness on the robot. prediction error: of the models that a controller was evolved in."
    )
    return TableElement("Forecasts", (*heads, "coverage", "controllers"), tuple(rows), note=f"{note} {_basis(results)}")


def time_sheet(results: StudyResults) -> TableElement:
    """Time by kind of cell; cells that several points need count once."""
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
    note = "Time on one processor each; cells that several points need count once."
    return TableElement("Time", ("kind of cell", "cells", "min", "s a cell"), tuple(text), note=note)


def point_sheet(results: StudyResults) -> TableElement:
    """Every point: its progress, the controller chosen there, and its fitness."""
    chosen = {row.point: row for row in results.controllers if row.chosen}
    rows = []
    for point in results.points:
        row = chosen.get(point.name)
        state = f"{point.done} of {point.cells}" + (f", {point.failed} failed" if point.failed else "")
        values = (None,) * 3 if row is None else (row.forecast, row.achieved, row.best_known)
        rows.append((point.name, state, "–" if row is None else row.controller, *map(three_digits, values)))
    heads = ("point", "cells", "chosen", "forecast", "achieved", "best known")
    return TableElement("Points", heads, tuple(rows), details=len(rows) > 12)


def settings_sheet(results: StudyResults) -> TableElement:
    """Settings common to all points, the axes, and the versions of packages."""
    study = results.study
    rows = [(name, label_of(value)) for name, value in study.experiment.items()]
    for grid in study.grids:
        rows += [(f"{axis} (axis)", "; ".join(values.values)) for axis, values in grid.items()]
    rows += [(f"version of {name}", version) for name, version in results.versions.items()]
    return TableElement("Settings", ("name", "value"), tuple(rows), prose=True, details=True)


def _spread(found: Spread | None, digits: int | None = None, *, sign: bool = False) -> str:
    """Return a mean, and below it its interval if there is one; ``digits`` None are those that the interval allows."""
    if found is None:
        return "–"
    return lines(_written(found.mean, found, digits, sign=sign), _between(found, digits, sign=sign))


def _between(found: Spread, digits: int | None, *, sign: bool = False) -> str:
    if found.low is None or found.high is None:
        return ""
    return " to ".join(_written(end, found, digits, sign=sign) for end in (found.low, found.high))


def _written(value: float, found: Spread, digits: int | None, *, sign: bool) -> str:
    error = np.nan if found.low is None or found.high is None else (found.high - found.low) / ERRORS_WIDE
    text = by_error(value, error) if digits is None else number(value, digits)
    return f"+{text}" if sign and not text.startswith("-") else text


def _basis(results: StudyResults) -> str:
    """Return the number of robots and seeds of the intervals, or why there are none."""
    begun = {row.point for row in results.models} | {row.point for row in results.controllers}
    robots = len({point.where for point in results.points if point.name in begun})
    seeds = len({point.seed for point in results.points if point.name in begun})
    counted = f"{robots} robot{'s' * (robots != 1)} and {seeds} seed{'s' * (seeds != 1)}"
    if robots >= 3 or (robots == 1 and seeds >= 3):
        over = "robots and seeds" if robots > 1 and seeds > 1 else "robots" if robots > 1 else "seeds of one robot"
        return f"Means and {percent(CONFIDENCE)} intervals over {over} ({counted})."
    return f"Means over {counted}: too few for an interval, which takes three robots, or three seeds of one."


def differing_axes(
    results: StudyResults, groups: Sequence[tuple[str, ...]]
) -> tuple[list[str], Callable[[tuple[str, ...]], list[str]]]:
    """Return the axes along which ``groups`` differ, and a function that selects the labels of a group along these."""
    places = [place for place, labels in enumerate(zip(*groups, strict=True)) if len(set(labels)) > 1]
    axes = [results.study.group_axes[place] for place in places]
    return axes, lambda group: [group[place] for place in places]


def _unit(results: StudyResults, form: str) -> str:
    """Return the unit common to all fitness values in this form, such as ``" ({})"``; empty if there is none."""
    units = dict.fromkeys(point.unit for point in results.points if point.unit)
    return form.format(next(iter(units))) if len(units) == 1 else ""


def normalised_picture(results: StudyResults) -> FigureElement | None:
    """Draw the normalised fitness of each controller."""
    figures = [(one.group, one.controller, one.normalised) for one in controller_figures(results)]
    caption = "Achieved fitness divided by the best known on each robot, both minus that of controls at rest."
    label = "normalised fitness"
    return _picture("normalised", "Achieved fitness", _drawn(figures), label, caption, line=1.0)


def gap_picture(results: StudyResults) -> FigureElement | None:
    """Draw claimed minus achieved fitness of each controller."""
    figures = [(one.group, one.controller, one.gap) for one in controller_figures(results)]
    unit = _unit(results, " ({})")
    caption = "Right of 0: claimed fitness exceeds that on the robot."
    label = f"claimed - achieved{unit}"
    return _picture("gap", "Claimed minus achieved fitness", _drawn(figures), label, caption, line=0)


def error_picture(results: StudyResults) -> FigureElement | None:
    """Draw the prediction error of each model one second ahead."""
    axes = prediction_axes(results)
    figures = [(one.group if axes else (), one.model, one.n[20]) for one in prediction_figures(results)]
    caption = "On held-out data; 0 is perfect, 1 as bad as the mean."
    return _picture("errors", "Prediction error", _drawn(figures), "N after 20 steps", caption)


def _drawn(figures: list[tuple[tuple[str, ...], str, Spread | None]]) -> dict[str, dict[str, MeanAndInterval]]:
    found: dict[str, dict[str, MeanAndInterval]] = {}
    for group, name, one in figures:
        if one is not None:
            low, high = (one.mean if end is None else end for end in (one.low, one.high))
            found.setdefault(", ".join(group) or "mean", {})[name] = (one.mean, low, high)
    return found


ROW, FURTHER = 0.34, 0.13
"""Height of a row in inches, and of each further group."""


def _picture(
    key: str,
    title: str,
    drawn: Mapping[str, Mapping[str, MeanAndInterval]],
    label: str,
    caption: str,
    line: float | None = None,
) -> FigureElement | None:
    if not drawn:
        return None
    rows = len({name for found in drawn.values() for name in found})
    bars = any(low < high for found in drawn.values() for _, low, high in found.values())

    def drawing(name: str, width: float, name_width: int) -> Drawing:
        def draw(figure: Figure) -> None:
            plot_spreads(drawn, figure.add_subplot(), label=label, name_width=name_width, line=line)

        height = 0.9 + rows * (ROW + FURTHER * (len(drawn) - 1))
        return Drawing(
            name, f"{title}, for each name and group, with intervals", draw, width, height, keyed=len(drawn) > 1
        )

    pair = DrawingPair(drawing(key, WIDE, 26), drawing(f"{key}-narrow", NARROW, 13))
    bars_are = f"Bars: {percent(CONFIDENCE)} intervals over robots and seeds."
    no_bars = "There are no intervals: the study has too few robots and seeds."
    return FigureElement(title, f"{caption} {bars_are if bars else no_bars}", (pair,))


SCHEMA = "sysid-evo/study/3"


def study_document(results: StudyResults) -> dict[str, Any]:
    """Return the content of ``study.json``: settings, points, the figures of all tables, failures, times."""
    timings: dict[str, dict[str, float]] = {}
    for time in results.times:
        one = timings.setdefault(time.kind, {"cells": 0, "seconds": 0.0})
        one["cells"] += 1
        one["seconds"] += time.seconds
    document: dict[str, Any] = plain(
        {
            "schema": SCHEMA,
            "title": results.study.title,
            "settings": dict(results.study.settings),
            "group_axes": results.study.group_axes,
            "intervals": {"share": CONFIDENCE},
            "points": [{**asdict(point), "finished": point.finished} for point in results.points],
            "controllers": controller_figures(results),
            "prediction": [
                {**asdict(row), "n": {str(h): n and asdict(n) for h, n in row.n.items()}}
                for row in prediction_figures(results)
            ],
            "exploitability": exploit_figures(results),
            "forecasts": forecast_figures(results),
            "failures": results.failures,
            "versions": dict(results.versions),
            "timings": timings,
        }
    )
    return document
