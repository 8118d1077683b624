"""What a page is made of: answers, sections, tables, figures, cards.

All of it is data. Sections make it; `evaluation.report.render` turns it into a page, Markdown and tables of a terminal.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDE, NARROW, THIRD, QUARTER = 9.6, 3.55, 3.2, 2.6
"""Widths of drawings in inches: the page, a phone, and drawings beside each other."""

Tone = Literal["good", "bad", "open"]
"""Whether an answer is good news, bad news, or stays open."""


@dataclass(frozen=True)
class Page:
    """A report in its order: answers in a few words, then in sentences, a short table, and the sections."""

    title: str
    headlines: Sequence[Headline]
    findings: Sequence[Finding]
    overview: TableElement | None
    sections: Sequence[Section]


@dataclass(frozen=True)
class Headline:
    """One question, its answer in a few words, a sentence on it, and the command that acts on it, if there is one."""

    question: str
    answer: str
    sentence: str
    tone: Tone
    command: str = ""


@dataclass(frozen=True)
class Finding:
    """One question and its answers."""

    question: str
    answers: tuple[str, ...]


@dataclass(frozen=True)
class Section:
    """What stands under one heading: paragraphs, then figures, tables and cards in order.

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
    def sheets(self) -> tuple[TableElement, ...]:
        """The tables alone."""
        return tuple(item for item in self.items if isinstance(item, TableElement))

    @property
    def pictures(self) -> tuple[FigureElement, ...]:
        """The figures alone."""
        return tuple(item for item in self.items if isinstance(item, FigureElement))


@dataclass(frozen=True)
class TableElement:
    """A table of plain text: the first column names the rows. A cell may hold several lines.

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
    heat: Shading | None = None

    @property
    def sorts(self) -> bool:
        """Whether a reader may sort the rows."""
        return not (self.prose or self.code) and len(self.rows) > 1

    def __post_init__(self) -> None:
        object.__setattr__(self, "rows", tuple(tuple(row) for row in self.rows))


@dataclass(frozen=True)
class Shading:
    """What the page paints behind the cells of a table, without its first column.

    ``shades`` (rows, columns) from 0 to 1, None for no shade; ``framed`` cells (row, column) have a frame;
    a line stands left of the ``divided`` column. ``alarm`` paints in the colour of warnings.
    """

    shades: tuple[tuple[float | None, ...], ...]
    framed: frozenset[tuple[int, int]] = frozenset()
    divided: int | None = None
    alarm: bool = False


@dataclass(frozen=True)
class FigureElement:
    """Drawings under one title; ``caption`` says what they show. With ``columns`` they stand side by side."""

    title: str
    caption: str
    panels: tuple[DrawingPair, ...]
    columns: int = 0


@dataclass(frozen=True)
class DrawingPair:
    """One drawing for a wide screen; ``for_phone`` is the same for a narrow one, None where one does for both."""

    wide: Drawing
    for_phone: Drawing | None = None
    title: str = ""
    note: str = ""


@dataclass(frozen=True)
class Drawing:
    """What ``draw`` puts on an empty figure of ``width`` by ``height`` inches; `render.svg` alone calls it.

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


@dataclass(frozen=True)
class ReplayElement:
    """What the page's script plays: ``document`` is JSON for a script element, ``rows`` the names of the controllers.

    ``paths`` tells whether bodies on a plane are shown, or states over time.
    """

    rows: tuple[str, ...]
    document: str
    paths: bool
    caption: str


@dataclass(frozen=True)
class Cards:
    """Cards beside each other."""

    title: str
    cards: tuple[Card, ...]


@dataclass(frozen=True)
class Card:
    """What is said of one model or controller: a verdict to see at a glance, and sentences below it.

    ``watch`` is the row of the replay to look at, from ``time`` (s) on; empty for none.
    """

    title: str
    tone: Tone
    verdict: str
    sentences: Sequence[str]
    watch: str = ""
    time: float = 0.0


Item = FigureElement | TableElement | ReplayElement | Cards


def present(*items: Item | None) -> list[Item]:
    """Return the items that there are."""
    return [item for item in items if item is not None]


def wide_and_narrow(
    key: str,
    label: str,
    draw: Callable[[Figure], object],
    height: float,
    narrow_height: float,
    *,
    off: frozenset[str] = frozenset(),
) -> DrawingPair:
    """Return a keyed drawing for a wide screen and for a phone, heights in inches."""
    wide = Drawing(key, label, draw, WIDE, height, keyed=True, off=off)
    return DrawingPair(wide, replace(wide, key=f"{key}-narrow", width=NARROW, height=narrow_height))


def trial_name(controller: str, trial: int) -> str:
    """Return the row of the replay that shows this trial of a controller, counted from 0."""
    return controller if trial == 0 else f"{controller}, trial {trial + 1}"
