"""The parts of a page: answers, sections, tables, figures, cards.

All of it is data. Sections make it; `evaluation.report.render` turns it into a page, Markdown and tables of a terminal.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDE, NARROW, THIRD, QUARTER, HALF = 11.5, 3.55, 3.2, 2.6, 5.6
"""Widths of drawings in inches: the page, a phone, a third and a quarter of the page, next to the answers."""

Tone = Literal["good", "warn", "bad", "open"]
"""Kind of an answer: good news, good with exceptions, bad news, or not known."""


@dataclass(frozen=True)
class Page:
    """A report in its order: title, one line of ``facts``, ``warnings``, answers with one figure, table, sections."""

    title: str
    headlines: Sequence[Answer]
    findings: Sequence[Answer]
    overview: TableElement | None
    sections: Sequence[Section]
    facts: str = ""
    warnings: Sequence[str] = ()
    figure: FigureElement | None = None


@dataclass(frozen=True)
class Answer:
    """One question, its answer in a few words (empty if sentences alone answer it), and sentences.

    ``command`` is what to type next in the run folder, empty for nothing.
    """

    question: str
    answer: str
    sentences: tuple[str, ...]
    tone: Tone = "open"
    command: str = ""

    @property
    def sentence(self) -> str:
        """All sentences."""
        return " ".join(self.sentences)


@dataclass(frozen=True)
class Section:
    """One heading with paragraphs, sentences on what is ``absent`` and why, then figures, tables and cards in order.

    A terminal leaves out the tables of a ``background`` section. ``link`` is a shorter title for the list of sections.
    """

    title: str
    items: Sequence[Item] = ()
    paragraphs: Sequence[str] = ()
    absent: Sequence[str] = ()
    background: bool = False
    link: str = ""

    @property
    def anchor(self) -> str:
        """The name of the section in a link."""
        return "".join(letter if letter.isalnum() else "-" for letter in (self.link or self.title).lower())

    @property
    def flat(self) -> tuple[Item, ...]:
        """All items, those inside a `Fold` included."""
        parts = ((item, *item.items) if isinstance(item, Fold) else (item,) for item in self.items)
        return tuple(part for found in parts for part in found)

    @property
    def sheets(self) -> tuple[TableElement, ...]:
        """The tables alone."""
        return tuple(item for item in self.flat if isinstance(item, TableElement))

    @property
    def pictures(self) -> tuple[FigureElement, ...]:
        """The figures alone."""
        return tuple(item for item in self.flat if isinstance(item, FigureElement))


@dataclass(frozen=True)
class Fold:
    """Items that the page shows when a reader opens their title."""

    title: str
    items: Sequence[Item]


@dataclass(frozen=True)
class TableElement:
    """A table of plain text: the first column names the rows. A cell may hold several lines.

    ``note`` explains the numbers. The page folds a table with ``details`` away, sets the cells of ``prose`` as text,
    shades cells by ``heat``, prints ``marked`` cells (row, column) in bold, and keeps the first ``sticky`` columns in
    view. ``commands`` has a command to copy for each row, empty for none.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""
    details: bool = False
    prose: bool = False
    heat: Shading | None = None
    marked: frozenset[tuple[int, int]] = frozenset()
    sticky: int = 1
    commands: tuple[str, ...] = ()

    @property
    def sorts(self) -> bool:
        """Whether a reader may sort the rows."""
        return not self.prose and len(self.rows) > 1


@dataclass(frozen=True)
class Shading:
    """Shades (rows, columns) from 0 to 1 of the cells of a table without its first column, None for no shade.

    ``framed`` cells have a frame, the ``divided`` column a line on its left; ``alarm`` is the colour of warnings.
    """

    shades: tuple[tuple[float | None, ...], ...]
    framed: frozenset[tuple[int, int]] = frozenset()
    divided: int | None = None
    alarm: bool = False


@dataclass(frozen=True)
class FigureElement:
    """Drawings under one title, in ``columns``; with ``choose``, such as "Episode", a reader picks one by title."""

    title: str
    caption: str
    panels: tuple[DrawingPair, ...]
    columns: int = 0
    details: bool = False
    choose: str = ""


@dataclass(frozen=True)
class DrawingPair:
    """One drawing for a wide screen; ``for_phone`` is the same for a narrow one, None where one does for both."""

    wide: Drawing
    for_phone: Drawing | None = None
    title: str = ""
    note: str = ""


@dataclass(frozen=True)
class Drawing:
    """A drawing of ``width`` by ``height`` inches, made by ``draw`` on an empty figure; only `render.svg` calls it.

    ``key`` is its name among the drawings of a report; ``label`` is read aloud. The legend of a ``keyed`` drawing is
    outside of it in the page, and inside in a file. Series that are ``off`` are hidden until a reader shows them.
    ``links`` are rows of the replay, with a sentence to show, for the artists with the id ``link-0``, ``link-1``, ...
    """

    key: str
    label: str
    draw: Callable[[Figure], object]
    width: float
    height: float
    keyed: bool = False
    off: frozenset[str] = frozenset()
    links: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class ReplayElement:
    """Trials that the page plays: a JSON ``document``, controllers (``rows``), bodies (``paths``) or states."""

    rows: tuple[str, ...]
    document: str
    paths: bool
    caption: str


@dataclass(frozen=True)
class Cards:
    """Cards next to each other."""

    title: str
    cards: tuple[Card, ...]


@dataclass(frozen=True)
class Card:
    """One model: verdict and sentences, one line if ``folded``; ``watch`` is a row of the replay."""

    title: str
    tone: Tone
    verdict: str
    sentences: Sequence[str]
    watch: str = ""
    folded: bool = False


Item = FigureElement | TableElement | ReplayElement | Cards | Fold


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
