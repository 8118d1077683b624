"""Figures of a report: drawn when they are asked for, inside the page or as a file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.typing import ColorType

from evaluation.plots import new_figure, style, to_svg
from evaluation.report.inline import VARIABLES, inline_svg

DASHES = {"-": "", "--": "5 3", ":": "1.5 2.5"}


@dataclass(frozen=True)
class Key:
    """One entry of a legend: a line in ``colour`` (CSS), with ``dashes`` (SVG)."""

    label: str
    colour: str
    dashes: str


@dataclass(frozen=True)
class Drawing:
    """What ``draw`` puts on an empty figure of ``width`` by ``height`` inches.

    ``key`` is its name among the drawings of a report; ``label`` is read aloud.
    """

    key: str
    label: str
    draw: Callable[[Figure], object]
    width: float
    height: float

    @cached_property
    def figure(self) -> Figure:
        """The figure, drawn in the style of the report."""
        with style():
            figure = new_figure(self.width, self.height)
            self.draw(figure)
        return figure

    @cached_property
    def svg(self) -> str:
        """The figure as an element of the page."""
        with style():
            return inline_svg(self.figure, self.key, self.label)

    @property
    def file(self) -> str:
        """The figure as an SVG file of its own, on no background."""
        return to_svg(self.figure)

    @property
    def legend(self) -> tuple[Key, ...]:
        """The named lines of the first axes."""
        return tuple(
            Key(str(line.get_label()), _variable(line.get_color()), DASHES.get(str(line.get_linestyle()), ""))
            for line in self.figure.axes[0].get_lines()
            if not str(line.get_label()).startswith("_")
        )


@dataclass(frozen=True)
class Panel:
    """One drawing for a wide screen; ``for_phone`` is the same for a narrow one, None where one does for both."""

    wide: Drawing
    for_phone: Drawing | None = None
    title: str = ""
    note: str = ""

    @property
    def svg(self) -> str:
        """The drawing for a wide screen, as an element of the page."""
        return self.wide.svg

    @property
    def narrow(self) -> str:
        """The drawing for a phone; empty where the wide one does."""
        return "" if self.for_phone is None else self.for_phone.svg


@dataclass(frozen=True)
class Picture:
    """Drawings under one title; ``caption`` says what they show. With ``columns`` they stand side by side.

    A ``keyed`` picture has a legend of its lines beside the drawings.
    """

    title: str
    caption: str
    panels: tuple[Panel, ...]
    columns: int = 0
    keyed: bool = False

    @property
    def legend(self) -> tuple[Key, ...]:
        """The legend of the first panel, for those that have one."""
        return self.panels[0].wide.legend if self.keyed else ()


def _variable(colour: ColorType) -> str:
    value = to_hex(colour)
    return VARIABLES.get(value, value)
