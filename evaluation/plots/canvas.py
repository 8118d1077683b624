"""Figures without global state: object-oriented matplotlib, the Agg backend, reproducible SVG."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from evaluation.plots.theme import GRID, INK, LINES, REFERENCE_GREY
from sysid_evo.arrays import Array

STYLE: dict[Any, Any] = {
    "axes.axisbelow": True,
    "axes.edgecolor": INK.light,
    "axes.labelcolor": INK.light,
    "axes.grid": True,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlesize": 9.0,
    "axes.titleweight": "bold",
    "axes.labelsize": 9.0,
    "font.size": 9.0,
    "grid.alpha": 0.3,
    "grid.color": GRID.light,
    "legend.fontsize": 8.0,
    "legend.frameon": False,
    "svg.fonttype": "none",
    "svg.hashsalt": "sysid-evo",
    "text.color": INK.light,
    "text.parse_math": False,
    "xtick.color": INK.light,
    "ytick.color": INK.light,
}
COLOURS = tuple(colour.light for colour in LINES)
DASHES = ("-", "--", ":")
MEASURED = INK.light
REFERENCE = REFERENCE_GREY.light


@contextmanager
def style() -> Iterator[None]:
    """Draw in the style of the report; names are never taken for mathematics."""
    with mpl.rc_context(STYLE):
        yield


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure of that size in inches, laid out so that nothing overlaps."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def axes_or_new(ax: Axes | None, width: float = 7.0, height: float = 3.6) -> Axes:
    """Return ``ax``, or the axes of a new figure."""
    return new_figure(width, height).add_subplot() if ax is None else ax


def line_style(number: int) -> dict[str, Any]:
    """Return colour and dashes of line ``number``: 24 that can be told apart."""
    return {"color": COLOURS[number % len(COLOURS)], "linestyle": DASHES[number // len(COLOURS) % len(DASHES)]}


class Band(PolyCollection):
    """The interval ``low`` to ``high`` (n,) about the line called ``name`` at the same places ``x`` (n,)."""

    def __init__(self, name: str, x: Array, low: Array, high: Array, *, color: str, alpha: float) -> None:
        known = np.isfinite(low) & np.isfinite(high)
        places = np.flatnonzero(known)
        runs = np.split(places, np.flatnonzero(np.diff(places) > 1) + 1)
        outlines = [
            np.column_stack([np.r_[x[run], x[run][::-1]], np.r_[low[run], high[run][::-1]]]) for run in runs if len(run)
        ]
        super().__init__(outlines, facecolors=color, alpha=alpha, linewidths=0.0)
        self.name, self.low, self.high = name, low, high


def to_svg(figure: Figure) -> str:
    """Return the figure as SVG text on no background; the same figure always gives the same text."""
    stream = io.StringIO()
    with style():
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None}, transparent=True)
    return stream.getvalue()
