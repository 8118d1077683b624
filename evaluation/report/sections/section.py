"""A part of the report: what stands under one heading."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from evaluation.report.cards import Cards
from evaluation.report.drawing import Picture
from evaluation.report.replay import Replay
from evaluation.report.sheets import Sheet

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
