"""What a report says of forecasts: the sentence by which a controller was chosen, and two tables."""

from __future__ import annotations

from evaluation.forecast import Forecast
from evaluation.labels import percent
from evaluation.report.contents import Report
from evaluation.report.sheets import Sheet, lines, listed, number, plus_minus
from evaluation.transfer import ControllerSummary

EXPLAINED = (
    "forecast: expected on the robot, the median of all models; a model weighs as the inverse square of its prediction "
    "error, half as much in a family that the controller was evolved in. Nothing measured on the robot is in it but "
    "the recordings. In brackets: the 90 % interval, calibrated on emulated cars."
)


def forecast_text(found: Forecast) -> str:
    """Return a forecast with its interval."""
    return f"{number(found.value)} ({number(found.low)} to {number(found.high)})"


def why_chosen(report: Report) -> str | None:
    """Say by what the controller to drive was chosen, and what was achieved; None where no forecast chose it."""
    summary = report.transfer
    found = None if summary is None or summary.pick is None else report.forecasts.get(summary.pick)
    if summary is None or found is None:
        return None
    unit = f" {report.matrix.unit}" if report.matrix is not None and report.matrix.unit else ""
    picked = summary.controller(found.controller)
    count = sum(one.name in report.forecasts and bool(one.against) for one in summary.controllers)
    rivals = f"the highest of {count} forecasts" if count > 1 else "the only one with a forecast"
    said = f"Chosen without the robot: {found.controller}, {rivals}: {forecast_text(found)}{unit} are expected of it"
    if picked.achieved is None:
        return f"{said}."
    inside = "as forecast" if found.holds(picked.achieved) else "outside the interval"
    return f"{said}; it achieves {picked.achieved.value:.1f} on the robot, {inside}."


def forecast_sheet(report: Report) -> Sheet | None:
    """What is expected of every controller on the robot, beside what was claimed and achieved; None for nobody."""
    if report.transfer is None or report.matrix is None or not report.forecasts:
        return None
    with_robot = report.matrix.robot is not None
    known = [one for one in report.transfer.controllers if one.name in report.forecasts]
    known.sort(key=lambda one: -report.forecasts[one.name].value)
    rows = [_row(one, report, with_robot) for one in known]
    heads = ("controller", "claimed", "forecast", *(("on the\nrobot", "in the\ninterval") if with_robot else ()))
    judged = [report.forecasts[one.name].holds(one.achieved) for one in known if one.achieved is not None]
    held = f" {sum(judged)} of {len(judged)} were inside." if judged else ""
    return Sheet(
        title=f"Forecast for the robot ({report.matrix.unit or 'fitness'})",
        columns=heads,
        rows=tuple(rows),
        note=f"{EXPLAINED}{held}",
    )


def model_forecast_sheet(report: Report) -> Sheet | None:
    """What is expected of the controllers evolved in each model; None where no model has any."""
    if not report.model_forecasts:
        return None
    rows = []
    for name, found in report.model_forecasts.items():
        kept = found.kept
        share = "–" if kept is None else f"{percent(kept[0])} ({percent(kept[1])} to {percent(kept[2])})"
        weight = report.forecasts[found.controllers[0]].weights.get(name)
        rows.append(
            (
                lines(name, "" if found.controllers == (name,) else f"({listed(found.controllers)})"),
                number(found.claimed),
                f"{number(found.value)} ({number(found.low)} to {number(found.high)})",
                share,
                "–" if weight is None else percent(weight),
            )
        )
    return Sheet(
        title="Forecast for models: what becomes of a claim made in them",
        columns=("model", "claimed", "forecast", "share of\nthe claim", "own\nweight"),
        rows=tuple(rows),
        note="Means over the controllers evolved in each model alone. own weight: how much it counts in that.",
    )


def _row(controller: ControllerSummary, report: Report, with_robot: bool) -> tuple[str, ...]:
    found = report.forecasts[controller.name]
    chosen = report.transfer is not None and controller.name == report.transfer.pick
    row = [lines(controller.name, "(chosen)" if chosen else ""), plus_minus(controller.claimed), forecast_text(found)]
    if with_robot:
        inside = "–" if controller.achieved is None else ("yes" if found.holds(controller.achieved) else "no")
        row += [plus_minus(controller.achieved), inside]
    return tuple(row)
