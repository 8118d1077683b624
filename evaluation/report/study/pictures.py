"""The pictures of a study: means with their intervals, a row for each controller or model, a colour for each group."""

from __future__ import annotations

from collections.abc import Mapping

from matplotlib.figure import Figure

from evaluation.plots import plot_spreads
from evaluation.report.drawing import Drawing, Panel, Picture
from evaluation.report.pictures import NARROW, WIDE
from evaluation.study import Spread, StudyResults, controller_figures, prediction_figures
from evaluation.study.models import prediction_axes

ROW, FURTHER = 0.34, 0.13
"""Inches of a row, and what each further group adds."""
BARS = "Bars: 95 % intervals over robots and seeds."
NO_BARS = "There are no intervals: the study has too few robots and seeds."
Drawn = Mapping[str, Mapping[str, tuple[float, float, float]]]


def share_picture(results: StudyResults) -> Picture | None:
    """Draw the share of the yardstick that each controller achieves."""
    figures = [(one.group, one.controller, one.share) for one in controller_figures(results)]
    drawn = _drawn(figures)
    caption = "Share of the best that is known to be achieved on each robot."
    return _picture("share", "What controllers achieve", drawn, "share of the yardstick", caption, line=1.0)


def gap_picture(results: StudyResults) -> Picture | None:
    """Draw what each controller claims too much."""
    figures = [(one.group, one.controller, one.gap) for one in controller_figures(results)]
    units = {point.unit for point in results.points if point.unit}
    unit = f" ({next(iter(units))})" if len(units) == 1 else ""
    caption = "Right of 0 they claim more than the robot shows."
    return _picture(
        "gap", "What controllers claim too much", _drawn(figures), f"claimed - achieved{unit}", caption, line=0
    )


def error_picture(results: StudyResults) -> Picture | None:
    """Draw how well each model predicts a second ahead."""
    axes = prediction_axes(results)
    figures = [(one.group if axes else (), one.model, one.n[20]) for one in prediction_figures(results)]
    caption = "On data that were held back; 0 is perfect, 1 as bad as the mean."
    return _picture("errors", "How well models predict", _drawn(figures), "N after 20 steps", caption)


def _drawn(figures: list[tuple[tuple[str, ...], str, Spread | None]]) -> Drawn:
    found: dict[str, dict[str, tuple[float, float, float]]] = {}
    for group, name, one in figures:
        if one is not None:
            low, high = (one.mean if end is None else end for end in (one.low, one.high))
            found.setdefault(", ".join(group) or "mean", {})[name] = (one.mean, low, high)
    return found


def _picture(key: str, title: str, drawn: Drawn, label: str, caption: str, line: float | None = None) -> Picture | None:
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

    panel = Panel(drawing(key, WIDE, 26), drawing(f"{key}-narrow", NARROW, 13))
    return Picture(title, f"{caption} {BARS if bars else NO_BARS}", (panel,))
