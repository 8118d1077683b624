"""Colours for light and dark, figures without global state, reproducible SVG.

Matplotlib is used in its object-oriented form with the Agg backend, and loaded by the functions that draw.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid_evo.types import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import PolyCollection
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Colour:
    """One colour by its ``name``; plots use the light form, and the page replaces it in dark mode."""

    name: str
    light: str
    dark: str

    @property
    def variable(self) -> str:
        """The CSS variable of the colour."""
        return f"var(--{self.name})"


INK = Colour("ink", "#1b1f24", "#e4e8ec")
PAPER = Colour("paper", "#ffffff", "#15191e")
MUTED = Colour("muted", "#57606a", "#a3adb8")
RULE = Colour("rule", "#d8dee4", "#343c45")
GRID = Colour("grid", "#b0b0b0", "#6b7480")
REFERENCE_GREY = Colour("reference", "#888888", "#98a1ab")
LINES = (
    Colour("blue", "#0072b2", "#4ba3e3"),
    Colour("vermilion", "#d55e00", "#f58442"),
    Colour("green", "#009e73", "#2cc79a"),
    Colour("pink", "#cc79a7", "#e59cc4"),
    Colour("amber", "#e69f00", "#f3ba3d"),
    Colour("sky", "#56b4e9", "#8fd3fb"),
    Colour("violet", "#7b4fa3", "#b18ad8"),
    Colour("brown", "#8c6d31", "#c5a562"),
)
"""Okabe and Ito's colours for the colour-blind, and two more."""
BOX = Colour("box", "#f2f6fa", "#1d242c")
LINK = Colour("link", "#0b5a8f", "#7cc0f2")
HEAT = Colour("heat", "#5fb0de", "#1b6494")
ALARM = Colour("alarm", "#f29a63", "#a4501b")
THEME = (INK, PAPER, MUTED, RULE, GRID, REFERENCE_GREY, *LINES, BOX, LINK, HEAT, ALARM)

COLOURS = tuple(colour.light for colour in LINES)
MEASURED = INK.light
REFERENCE = REFERENCE_GREY.light
DASHES = {"-": "", "--": "5 3", ":": "1.5 2.5"}
"""Styles of lines, and their dashes in SVG."""

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


def style_sheet() -> str:
    """Return the colours as CSS variables: dark ones on a screen in dark mode, light ones on paper."""
    light, dark = (" ".join(f"--{c.name}: {getattr(c, form)};" for c in THEME) for form in ("light", "dark"))
    return f":root {{ {light} }}\n@media screen and (prefers-color-scheme: dark) {{ :root {{ {dark} }} }}"


@contextmanager
def style() -> Iterator[None]:
    """Draw in the style of the report; names are never read as mathematical text."""
    import matplotlib as mpl

    with mpl.rc_context(STYLE):
        yield


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure of that size in inches, with a layout without overlaps."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def line_style(number: int) -> dict[str, Any]:
    """Return colour and dashes of line ``number``, one of 24 combinations."""
    return {"color": COLOURS[number % len(COLOURS)], "linestyle": tuple(DASHES)[number // len(COLOURS) % len(DASHES)]}


@dataclass(frozen=True)
class Band:
    """The interval ``low`` to ``high`` (n,) of the line called ``name``; ``shape`` is its drawn form."""

    name: str
    low: Array
    high: Array
    shape: PolyCollection


OPAQUE = 0.13
"""How opaque an interval is drawn."""


def draw_band(ax: Axes, name: str, x: Array, low: Array, high: Array, color: str) -> None:
    """Draw an interval (n,) around the line called ``name`` at the same places ``x`` (n,); `bands` finds it again."""
    from matplotlib.collections import PolyCollection

    known = np.isfinite(low) & np.isfinite(high)
    places = np.flatnonzero(known)
    runs = np.split(places, np.flatnonzero(np.diff(places) > 1) + 1)
    outlines = [
        np.column_stack([np.r_[x[run], x[run][::-1]], np.r_[low[run], high[run][::-1]]]) for run in runs if len(run)
    ]
    kind = type("Band", (PolyCollection,), {})  # the class names the group in an SVG file
    shape = kind(outlines, facecolors=color, alpha=OPAQUE, linewidths=0.0)
    vars(shape)["band"] = Band(name, low, high, shape)
    ax.add_collection(shape)


def bands(ax: Axes) -> dict[str, Band]:
    """Return the intervals that `draw_band` drew on ``ax``, by the name of their line."""
    return {band.name: band for shape in ax.collections if (band := vars(shape).get("band")) is not None}


def to_svg(figure: Figure) -> str:
    """Return the figure as SVG text on no background; the same figure always gives the same text."""
    stream = io.StringIO()
    with style():
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None}, transparent=True)
    return stream.getvalue()
