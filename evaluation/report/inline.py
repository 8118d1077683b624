"""Figures as SVG inside the page: small, with the page's fonts, in colours that follow its theme."""

from __future__ import annotations

import html
import re
from collections.abc import Collection

from matplotlib.figure import Figure

from evaluation.plots import to_svg
from evaluation.plots.theme import THEME

VARIABLES = {colour.light: colour.variable for colour in THEME}
LEFT_OUT = re.compile(r"<metadata>.*?</metadata>|<style.*?</style>|<!--.*?-->", re.DOTALL)
FONT = re.compile(r" font-family: [^;\"]*;")
PAINT = re.compile(r"(fill|stroke): (#[0-9a-f]{6})")
MARK = "series-"
MARKED = re.compile(r' id="series-(\d+)"')
NAMED = re.compile(r' id="([^"]*)"')
MENTIONED = re.compile(r'(?:href="#|url\(#)([^")]*)')
PATH = re.compile(r' d="([^"]*)"')
DECIMALS = re.compile(r"(\.\d\d)\d+")
SPACE = re.compile(r">\s+<")


def inline_svg(figure: Figure, key: str, label: str, off: Collection[int] = ()) -> str:
    """Return a figure as an ``svg`` element that is as wide as its place.

    ``key`` makes its ids differ from those of other figures of the page; ``label`` is read aloud. Coordinates
    are rounded to a hundredth of a point. Colours of the theme become the variables of its style sheet. What was
    marked by `mark_series` carries the number of its series; those that are ``off`` are hidden.
    """
    text = to_svg(figure)
    text = LEFT_OUT.sub("", text[text.index("<svg") :]).replace("xlink:href", "href")
    text = FONT.sub("", text)
    text = PAINT.sub(lambda found: f"{found[1]}: {VARIABLES.get(found[2], found[2])}", text)
    mentioned = set(MENTIONED.findall(text))
    text = MARKED.sub(lambda found: _series(int(found[1]), off), text)
    text = NAMED.sub(lambda found: f' id="{key}-{found[1]}"' if found[1] in mentioned else "", text)
    text = MENTIONED.sub(lambda found: found[0].replace("#", f"#{key}-"), text)
    text = PATH.sub(lambda found: f' d="{_short(found[1])}"', text)
    text = SPACE.sub("><", text).strip()
    box = re.search(r'viewBox="[^"]*"', text)
    assert box is not None
    start = f'<svg {box[0]} role="img" aria-label="{html.escape(label)}">'
    return start + text[text.index(">") + 1 :]


def _short(path: str) -> str:
    return " ".join(DECIMALS.sub(r"\1", path).split())


def _series(number: int, off: Collection[int]) -> str:
    return f' data-series="{number}"' + (' class="off"' if number in off else "")
