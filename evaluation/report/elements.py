"""What a page is made of: answers, sections, tables, figures, cards."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

from matplotlib.figure import Figure

from evaluation.plot_style import new_figure, style, to_svg
from evaluation.report.render.svg import Key, chart_document, inline_svg, legend_of, mark_series, names_of
from evaluation.results import Report
from evaluation.transfer.summary import ControllerSummary


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


@dataclass(frozen=True)
class Sheet:
    """A table: the first column names the rows. A cell may hold several lines.

    ``note`` says how the numbers came about; ``details`` asks the page to fold the table away, ``prose``
    to set its cells as text rather than as numbers, ``code`` as commands to copy; ``heat`` paints them.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""
    details: bool = False
    prose: bool = False
    code: bool = False
    heat: Heat | None = None

    @property
    def sorts(self) -> bool:
        """Whether a reader may sort the rows."""
        return not (self.prose or self.code) and len(self.rows) > 1

    def __post_init__(self) -> None:
        object.__setattr__(self, "rows", tuple(tuple(row) for row in self.rows))


@dataclass(frozen=True)
class Replay:
    """What the page's script plays: ``document`` is JSON for a script element, ``rows`` the names of the controllers.

    ``paths`` tells whether bodies on a plane are shown, or states over time; ``left_out`` trials would make the page
    too large.
    """

    rows: tuple[str, ...]
    document: str
    paths: bool
    left_out: int = 0

    @property
    def caption(self) -> str:
        from evaluation.report.sections.replay import CONTROLS, ON_A_PLANE, OVER_TIME

        fewer = f" {self.left_out} trials on other models are left out to keep the page small." if self.left_out else ""
        return (ON_A_PLANE if self.paths else OVER_TIME) + CONTROLS + fewer


@dataclass(frozen=True)
class Cards:
    """Cards beside each other."""

    title: str
    cards: tuple[Card, ...]


Item = Picture | Sheet | Replay | Cards


@dataclass(frozen=True)
class Section:
    """A part of the page: paragraphs, then pictures and tables in order.

    ``absent`` says, a sentence each, what cannot be shown here and why. A ``background`` section tells how the numbers
    came about, or what is said elsewhere too; the terminal leaves its tables out.
    """

    title: str
    items: Sequence[Item] = ()
    paragraphs: Sequence[str] = ()
    absent: Sequence[str] = ()
    background: bool = False

    @property
    def anchor(self) -> str:
        """The name of the section in a link."""
        return "".join(letter if letter.isalnum() else "-" for letter in self.title.lower())

    @property
    def sheets(self) -> tuple[Sheet, ...]:
        """The tables alone."""
        return tuple(item for item in self.items if isinstance(item, Sheet))

    @property
    def pictures(self) -> tuple[Picture, ...]:
        """The figures alone."""
        return tuple(item for item in self.items if isinstance(item, Picture))


def present(*items: Item | None) -> list[Item]:
    """Return the items that there are."""
    return [item for item in items if item is not None]


WIDE, NARROW, THIRD, QUARTER = 9.6, 3.55, 3.2, 2.6
"""Widths in inches: the page, a phone, and panels beside each other."""


def _both(
    key: str,
    label: str,
    draw: Callable[[Figure], object],
    height: float,
    narrow_height: float,
    *,
    off: frozenset[str] = frozenset(),
) -> Panel:
    """Return a keyed drawing for a wide screen and for a phone, heights in inches."""
    wide = Drawing(key, label, draw, WIDE, height, keyed=True, off=off)
    return Panel(wide, replace(wide, key=f"{key}-narrow", width=NARROW, height=narrow_height))


@dataclass(frozen=True)
class Heat:
    """What the page paints behind the cells of a table, without its first column.

    ``shades`` (rows, columns) from 0 to 1, None for no shade; ``framed`` cells (row, column) have a frame;
    a line stands left of the ``divided`` column. ``alarm`` paints in the colour of warnings.
    """

    shades: tuple[tuple[float | None, ...], ...]
    framed: frozenset[tuple[int, int]] = frozenset()
    divided: int | None = None
    alarm: bool = False


def of_each_run(controller: ControllerSummary) -> str:
    """Return the fitness of the champion of each evolution run, three a line; empty for fewer than two runs."""
    found = [f"{fitness:.1f}" for fitness in controller.seed_fitness]
    return "\n".join(", ".join(found[i : i + 3]) for i in range(0, len(found), 3)) if len(found) > 1 else ""


@dataclass(frozen=True)
class Story:
    """Answers in a few words, then in sentences, a short table, and the sections."""

    title: str
    headlines: Sequence[Headline]
    findings: Sequence[Finding]
    overview: Sheet | None
    sections: Sequence[Section]

    @classmethod
    def of(cls, report: Report) -> Story:
        """Tell what a report holds."""
        from evaluation.report.report import sections
        from evaluation.report.sections.controllers import overview_sheet
        from evaluation.report.sections.summary import headlines, verdict

        return cls(report.title, headlines(report), verdict(report), overview_sheet(report), sections(report))


@dataclass(frozen=True)
class Card:
    """What is said of one thing: the first sentence as its head, the others below.

    ``watch`` is the row of the replay to look at, from ``time`` (s) on; empty for none.
    """

    title: str
    tone: Tone
    verdict: str
    sentences: Sequence[str]
    watch: str = ""
    time: float = 0.0


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


Tone = Literal["good", "bad", "open"]


@dataclass(frozen=True)
class Headline:
    """One question, its answer in a few words, a sentence on it, and the command that acts on it, if there is one.

    The ``tone`` is good news, bad news, or that it stays open.
    """

    question: str
    answer: str
    sentence: str
    tone: Tone
    command: str = ""


def trial_name(controller: str, trial: int) -> str:
    """Return the row of the replay that shows this trial of a controller, counted from 0."""
    return controller if trial == 0 else f"{controller}, trial {trial + 1}"


@dataclass(frozen=True)
class Finding:
    """One question and its answers."""

    question: str
    answers: tuple[str, ...]
