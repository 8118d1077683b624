"""The sections of two runs side by side: settings, prediction, transfer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from matplotlib.figure import Figure

from evaluation.plots import plot_changes
from evaluation.report.drawing import Drawing, Panel, Picture
from evaluation.report.pictures import NARROW, WIDE
from evaluation.report.predicting import horizon_name
from evaluation.report.sections.section import Section, present
from evaluation.report.two_runs.differences import Change, ControllerChange, Differences
from evaluation.report.two_runs.tables import controller_sheet, error_sheet, setting_sheet, version_sheet

FIGURES = (
    ("claimed", "Claimed where evolved"),
    ("others", "Mean on the other models"),
    ("achieved", "Achieved on the robot"),
)
ROW = 0.45
"""Inches of one row in a picture."""


def changed(found: Differences) -> Section:
    """Say which settings, models and libraries differ."""
    absent = [] if found.settings else ["No setting differs."]
    for run, name in enumerate(found.names):
        if only := found.models_only_in(run):
            absent.append(f"Only in {name}: {', '.join(only)}.")
    return Section("Settings", present(setting_sheet(found), version_sheet(found)), absent=absent)


def predicting(found: Differences) -> Section:
    """Compare errors, paired where both runs met the same test data."""
    if not found.errors:
        why = found.incomparable or "The runs have no model with errors at the same horizons in common."
        return Section("Prediction", absent=[why])
    sheets = [error_sheet(found, horizon) for horizon in found.errors]
    prediction = found.reports[0].prediction
    assert prediction is not None
    changes = {horizon_name(prediction, h): _drawn(changed) for h, changed in found.errors.items()}
    shown = {name: drawn for name, drawn in changes.items() if drawn}
    picture = _picture(
        "errors", "Change of N", shown, "N in the second run minus that in the first", len(sheets[0].rows)
    )
    return Section("Prediction", present(picture, *sheets))


def transferring(found: Differences) -> Section:
    """Compare claims and what is achieved, paired where both runs met the same trials."""
    sheets = [controller_sheet(found, figure, title) for figure, title in FIGURES]
    if not any(sheets):
        why = found.incomparable or found.other_tasks or _no_controller(found)
        return Section("Transfer", absent=[why])
    changes = {title: _drawn(_of(found.controllers, figure)) for figure, title in FIGURES}
    shown = {title: drawn for title, drawn in changes.items() if drawn}
    unit = f" ({found.unit})" if found.unit else ""
    label = f"second minus first{unit}"
    absent = []
    if not any(c.achieved is not None for c in found.controllers):
        absent.append(f"What is achieved on the robot is not compared: {_robots(found)}.")
    if not any(c.others is not None for c in found.controllers):
        absent.append(
            "The runs hold different models, so fitness on the other models, a mean over all of them, is not compared."
        )
    picture = _picture("fitness", "Change of fitness", shown, label, len(found.controllers))
    return Section("Transfer", present(picture, *sheets), absent=absent)


def _no_controller(found: Differences) -> str:
    rows = [() if report.matrix is None else report.matrix.rows for report in found.reports]
    for name, here in zip(found.names, rows, strict=True):
        if not here:
            return f"{name} holds no controller, so there is nothing to compare."
    told = "; ".join(f"{name} has {', '.join(here)}" for name, here in zip(found.names, rows, strict=True))
    return f"The runs have no controller of the same name in common: {told}."


def _robots(found: Differences) -> str:
    """Say on which robot each run was driven."""
    robots = [None if report.matrix is None else report.matrix.robot for report in found.reports]
    if robots[0] == robots[1] and robots[0] is not None:
        return f"no controller ran on {robots[0]} in both"
    told = [
        f"{name} on {robot}" if robot else f"{name} on none" for name, robot in zip(found.names, robots, strict=True)
    ]
    return "the runs were driven on different robots, " + " and ".join(told) if any(robots) else "neither was driven"


def _of(controllers: Sequence[ControllerChange], figure: str) -> dict[str, Change]:
    return {c.name: change for c in controllers if (change := getattr(c, figure)) is not None}


def _drawn(changes: Mapping[str, Change]) -> dict[str, tuple[float, float, float]]:
    return {
        name: (change.difference, change.interval.low, change.interval.high)
        for name, change in changes.items()
        if change.interval is not None
    }


def _picture(
    key: str, title: str, changes: dict[str, dict[str, tuple[float, float, float]]], label: str, rows: int
) -> Picture | None:
    if not changes:
        return None
    said = f"{title}, for each name and figure, with intervals"

    def draw(figure: Figure, name_width: int) -> None:
        plot_changes(changes, figure.add_subplot(), label=label, name_width=name_width)

    def drawn(name: str, width: float, name_width: int) -> Drawing:
        height = 1.0 + ROW * rows
        return Drawing(name, said, lambda figure: draw(figure, name_width), width, height, keyed=True)

    panel = Panel(drawn(key, WIDE, 26), drawn(f"{key}-narrow", NARROW, 13))
    return Picture(title, "Bars: 95 % intervals. One that holds 0 is no significant difference.", (panel,))
