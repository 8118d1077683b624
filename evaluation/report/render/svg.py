"""A figure as SVG, with the values that a reader can point at.

Inside the page a drawing is small, has the page's fonts, and colours that follow its theme; as a file it is whole.
"""

from __future__ import annotations

import html
import json
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from evaluation.plot_style import DASHES, THEME, Band, bands, new_figure, style, to_svg
from evaluation.report.elements import Drawing, DrawingPair
from sysid_evo.types import Array

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.container import ErrorbarContainer
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.typing import ColorType


@dataclass(frozen=True)
class LegendEntry:
    """One entry of a legend: a line in ``colour`` (CSS) with ``dashes`` (SVG), or a ``dot``, filled or a ring."""

    label: str
    colour: str
    dashes: str = ""
    dot: str = ""


@dataclass(frozen=True)
class DrawnPair:
    """A pair of drawings in the page; ``chart`` is JSON with the values of both. Without a part it is empty."""

    wide: str
    narrow: str
    legend: tuple[LegendEntry, ...]
    chart: str


def drawn(pair: DrawingPair) -> DrawnPair:
    """Draw both forms for the page."""
    wide = _figure(pair.wide)
    narrow = None if pair.for_phone is None else _figure(pair.for_phone)
    return DrawnPair(
        _element(pair.wide, wide),
        "" if narrow is None or pair.for_phone is None else _element(pair.for_phone, narrow),
        legend_of(wide) if pair.wide.keyed else (),
        readable_values(wide, narrow) if names_of(wide) else "",  # after both are drawn, and so laid out
    )


def svg_file(drawing: Drawing) -> str:
    """Return a drawing as an SVG file of its own, on no background, its legend inside."""
    figure = _on_paper(drawing)
    if drawing.keyed and not any(ax.get_legend() for ax in figure.axes):
        handles, labels = figure.axes[0].get_legend_handles_labels()
        with style():
            figure.legend(handles, labels, loc="outside upper center", ncols=max(1, round(drawing.width / 1.6)))
    return to_svg(figure)


def _on_paper(drawing: Drawing) -> Figure:
    with style():
        figure = new_figure(drawing.width, drawing.height)
        drawing.draw(figure)
    return figure


def _figure(drawing: Drawing) -> Figure:
    """Return the figure of the page: its series are marked, and the legend of a keyed one is left out."""
    figure = _on_paper(drawing)
    if drawing.keyed:
        for ax in figure.axes:
            if (legend := ax.get_legend()) is not None:
                legend.remove()
    mark_series(figure)
    return figure


def _element(drawing: Drawing, figure: Figure) -> str:
    off = [number for number, name in enumerate(names_of(figure)) if name in drawing.off]
    with style():
        return inline_svg(figure, drawing.key, drawing.label, off)


@dataclass(frozen=True)
class Series:
    """One named line or row of points: its values (n,), where they are, and their intervals where there are any.

    ``artists`` are what is drawn of it. Of points with bars to the side ``at`` is the row, a whole number.
    """

    name: str
    at: Array
    value: Array
    low: Array | None
    high: Array | None
    key: LegendEntry
    artists: tuple[Artist, ...] = field(repr=False)


def series_of(ax: Axes) -> list[Series]:
    """Return the named series of one axes, in the order in which they were drawn."""
    named = [line for line in ax.get_lines() if not str(line.get_label()).startswith("_")]
    found = bands(ax)
    return [*(_of_line(line, found.get(str(line.get_label()))) for line in named), *map(_of_bars, _error_bars(ax))]


def names_of(figure: Figure) -> tuple[str, ...]:
    """Return the names of all series of a figure, each once."""
    return tuple(dict.fromkeys(series.name for ax in figure.axes for series in series_of(ax)))


def mark_series(figure: Figure) -> None:
    """Give the artists of each series an id with its number."""
    names = names_of(figure)
    for ax in figure.axes:
        for series in series_of(ax):
            for artist in series.artists:
                artist.set_gid(f"{MARK}{names.index(series.name)}")


def legend_of(figure: Figure) -> tuple[LegendEntry, ...]:
    """Return an entry for each series of a figure."""
    return tuple({series.name: series.key for ax in figure.axes for series in series_of(ax)}.values())


def _error_bars(ax: Axes) -> list[ErrorbarContainer]:
    """Return rows of points with bars to the side; where there are any, values lie along the x-axis."""
    from matplotlib.container import ErrorbarContainer

    return [container for container in ax.containers if isinstance(container, ErrorbarContainer)]


def _of_line(line: Line2D, band: Band | None) -> Series:
    at, value = (np.asarray(values, dtype=float) for values in line.get_data())
    key = LegendEntry(str(line.get_label()), _variable(line.get_color()), DASHES.get(str(line.get_linestyle()), ""))
    artists = (line,) if band is None else (line, band.shape)
    low, high = (None, None) if band is None else (band.low, band.high)
    return Series(key.label, at, value, low, high, key, artists)


def _of_bars(container: ErrorbarContainer) -> Series:
    points, caps, bars = container.lines
    assert points is not None
    value, at = (np.asarray(values, dtype=float) for values in points.get_data())
    ends = np.array([segment[:, 0] for segment in bars[0].get_segments()])
    filled = str(points.get_markerfacecolor()) != "none"
    key = LegendEntry(
        str(container.get_label()), _variable(points.get_markeredgecolor()), dot="filled" if filled else "ring"
    )
    return Series(key.label, np.round(at), value, ends[:, 0], ends[:, 1], key, (points, *caps, *bars))


def _variable(colour: ColorType) -> str:
    """Return a colour of the theme as the variable of the page's style sheet, any other as it is."""
    from matplotlib.colors import to_hex

    value = to_hex(colour)
    return VARIABLES.get(value, value)


DIGITS = 4
"""Digits of a value that a reader can point at."""


def readable_values(figure: Figure, narrow: Figure | None) -> str:
    """Return what the page's script needs to read values off a figure, as JSON for a script element.

    ``narrow`` is the same figure for a phone. Both must have been drawn, so that they are laid out.
    """
    names = names_of(figure)
    axes = [ax for ax in figure.axes if series_of(ax)]
    document = {
        "names": names,
        "axes": [_axes(ax, names) for ax in axes],
        "frames": [_frame(ax, figure) for ax in axes],
        "narrow": None if narrow is None else [_frame(ax, narrow) for ax in narrow.axes if series_of(ax)],
    }
    text = json.dumps(document, allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    return text.replace("<", "\\u003c")


def _axes(ax: Axes, names: Sequence[str]) -> dict[str, Any]:
    sideways = bool(_error_bars(ax))
    named = [label.get_text().replace("\n", "") for label in ax.get_yticklabels()] if sideways else None
    value, place = (ax.get_xlabel(), ax.get_ylabel()) if sideways else (ax.get_ylabel(), ax.get_xlabel())
    if not place:
        place = next((other.get_xlabel() for other in reversed(ax.figure.axes) if other.get_xlabel()), "")
    return {
        "sideways": sideways,
        "rows": named,
        "value": value,
        "place": place,
        "series": [
            {
                "n": names.index(series.name),
                "at": _rounded(series.at),
                "value": _rounded(series.value),
                "low": None if series.low is None else _rounded(series.low),
                "high": None if series.high is None else _rounded(series.high),
            }
            for series in series_of(ax)
        ],
    }


def _frame(ax: Axes, figure: Figure) -> dict[str, Any]:
    """Return where an axes lies in the drawing (left, top, width, height in points), and what its edges mean."""
    width, height = (72.0 * size for size in figure.get_size_inches())
    box = ax.get_position()
    return {
        "box": [round(v, 2) for v in (box.x0 * width, (1.0 - box.y1) * height, box.width * width, box.height * height)],
        "x": {"ends": _rounded(np.array(ax.get_xlim())), "log": ax.get_xscale() == "log"},
        "y": {"ends": _rounded(np.array(ax.get_ylim())), "log": ax.get_yscale() == "log"},
    }


def _rounded(values: Array) -> list[float | None]:
    """Return numbers with few digits; what is no number is None."""
    return [float(f"{value:.{DIGITS}g}") if np.isfinite(value) else None for value in values]


VARIABLES = {colour.light: colour.variable for colour in THEME}
LEFT_OUT = re.compile(r"<metadata>.*?</metadata>|<style.*?</style>|<!--.*?-->", re.DOTALL)
FONT = re.compile(r" font-family: [^;\"]*;")
PAINT = re.compile(r"(fill|stroke): (#[0-9a-f]{6})")
MARK = "series-"
MARKED = re.compile(r' id="series-(\d+)"')
LINKED = re.compile(r' id="link-(\d+)"')
NAMED = re.compile(r' id="([^"]*)"')
MENTIONED = re.compile(r'(?:href="#|url\(#)([^")]*)')
PATH = re.compile(r' d="([^"]*)"')
DECIMALS = re.compile(r"(\.\d\d)\d+")
SPACE = re.compile(r">\s+<")


def inline_svg(figure: Figure, key: str, label: str, off: Collection[int] = ()) -> str:
    """Return a figure as an ``svg`` element that is as wide as its place.

    ``key`` makes its ids differ from those of other figures of the page; ``label`` is read aloud. Coordinates
    are rounded to a hundredth of a point. Colours of the theme become the variables of its style sheet. Elements of a
    series have its number, as those of a `Link` have; series that are ``off`` are hidden.
    """
    text = to_svg(figure)
    text = LEFT_OUT.sub("", text[text.index("<svg") :]).replace("xlink:href", "href")
    text = FONT.sub("", text)
    text = PAINT.sub(lambda found: f"{found[1]}: {VARIABLES.get(found[2], found[2])}", text)
    mentioned = set(MENTIONED.findall(text))
    hidden = {str(number) for number in off}
    text = MARKED.sub(lambda m: f' data-series="{m[1]}"' + (' class="off"' if m[1] in hidden else ""), text)
    text = LINKED.sub(r' data-link="\1"', text)
    text = NAMED.sub(lambda found: f' id="{key}-{found[1]}"' if found[1] in mentioned else "", text)
    text = MENTIONED.sub(lambda found: found[0].replace("#", f"#{key}-"), text)
    text = PATH.sub(lambda found: ' d="' + " ".join(DECIMALS.sub(r"\1", found[1]).split()) + '"', text)
    text = SPACE.sub("><", text).strip()
    box = re.search(r'viewBox="[^"]*"', text)
    assert box is not None
    start = f'<svg {box[0]} role="img" aria-label="{html.escape(label)}">'
    return start + text[text.index(">") + 1 :]
