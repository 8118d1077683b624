"""Figures of a report: drawn when they are asked for, inside the page or as a file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

from matplotlib.figure import Figure

from evaluation.plots import new_figure, style, to_svg
from evaluation.report.chart import Key, chart_document, legend_of, mark_series, names_of
from evaluation.report.inline import inline_svg


@dataclass(frozen=True)
class Drawing:
    """What ``draw`` puts on an empty figure of ``width`` by ``height`` inches.

    ``key`` is its name among the drawings of a report; ``label`` is read aloud. A ``keyed`` drawing has its legend
    beside it in the page, and inside as a file. The series that are ``off`` are hidden until they are asked for.
    """

    key: str
    label: str
    draw: Callable[[Figure], object]
    width: float
    height: float
    keyed: bool = False
    off: frozenset[str] = frozenset()

    @cached_property
    def figure(self) -> Figure:
        """The figure of the page, drawn in the style of the report."""
        figure = self._drawn()
        if self.keyed:
            for ax in figure.axes:
                if (legend := ax.get_legend()) is not None:
                    legend.remove()
        mark_series(figure)
        return figure

    @cached_property
    def svg(self) -> str:
        """The figure as an element of the page."""
        off = [number for number, name in enumerate(names_of(self.figure)) if name in self.off]
        with style():
            return inline_svg(self.figure, self.key, self.label, off)

    @property
    def file(self) -> str:
        """The figure as an SVG file of its own, on no background."""
        figure = self._drawn()
        if self.keyed and not any(ax.get_legend() for ax in figure.axes):
            handles, labels = figure.axes[0].get_legend_handles_labels()
            with style():
                figure.legend(handles, labels, loc="outside upper center", ncols=max(1, round(self.width / 1.6)))
        return to_svg(figure)

    @property
    def legend(self) -> tuple[Key, ...]:
        """An entry for each named series, for a drawing that is keyed."""
        return legend_of(self.figure) if self.keyed else ()

    def _drawn(self) -> Figure:
        with style():
            figure = new_figure(self.width, self.height)
            self.draw(figure)
        return figure


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

    @property
    def chart(self) -> str:
        """What the page's script needs to read values off the drawings, as JSON; empty where nothing is named."""
        if not names_of(self.wide.figure):
            return ""
        _ = self.svg, self.narrow  # what is drawn is laid out
        return chart_document(self.wide.figure, None if self.for_phone is None else self.for_phone.figure)


@dataclass(frozen=True)
class Picture:
    """Drawings under one title; ``caption`` says what they show. With ``columns`` they stand side by side."""

    title: str
    caption: str
    panels: tuple[Panel, ...]
    columns: int = 0

    @property
    def legend(self) -> tuple[Key, ...]:
        """The legend of the first panel, which is that of all."""
        return self.panels[0].wide.legend

    @property
    def off(self) -> frozenset[str]:
        """The series that are hidden until they are asked for."""
        return self.panels[0].wide.off
