"""Answers and tables for a terminal of 80 columns or more."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console, Group, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from evaluation.formatting import folded
from evaluation.report.elements import Answer, TableElement

WIDTH = 80
GAP = 2
NAMES = (28, 20, 13)
"""Widths to which the names of rows are folded: the first that saves dividing the table."""
DIVIDED = 20
"""And the width in a table that is divided all the same."""


def table_lines(sheet: TableElement) -> list[RenderableType]:
    """Return ``sheet`` as one table, or as several with the same rows where it is wider than 80 columns."""
    parts: list[RenderableType] = []
    names, groups = _layout(sheet)
    for number, group in enumerate(groups):
        continued = " (continued)" if number else ""
        parts.append(Text(sheet.title + continued, style="bold"))
        table = Table(box=None, padding=(0, 1))
        chosen = [0, *group]
        for column in chosen:
            # names and prose may wrap; numbers never do
            wraps = column == 0 or _width(sheet, column, names) > WIDTH // 2
            table.add_column(
                Text(sheet.columns[column]),
                justify="left" if wraps or sheet.prose else "right",
                no_wrap=not wraps,
                overflow="fold",
                vertical="top",
            )
        for row in sheet.rows:
            table.add_row(Text(folded(row[0], names)), *(Text(row[column]) for column in group))
        parts.append(table)
    if sheet.note:
        parts.append(Padding(Text(sheet.note, style="dim"), (0, 0, 1, 1)))
    return parts


def plain_text(parts: Sequence[RenderableType]) -> str:
    """Return what a terminal of 80 columns shows of ``parts``, without colours."""
    console = Console(width=WIDTH, color_system=None)
    with console.capture() as captured:
        for part in parts:
            console.print(part)
    return "\n".join(line.rstrip() for line in captured.get().splitlines())


def answer_lines(answers: Sequence[Answer]) -> list[RenderableType]:
    """Return questions and their answers; sentences that are the whole answer have a line each."""
    return [
        Group(
            Text(one.question, style="bold cyan"),
            *map(indented, (one.answer, one.sentence) if one.answer else one.sentences),
        )
        for one in answers
    ]


def indented(text: str) -> Padding:
    return Padding(Text(text), (0, 0, 0, 2))


def _layout(sheet: TableElement) -> tuple[int, list[list[int]]]:
    """Return the width of the names, and the other columns in groups that fit next to them: one, if possible."""
    for names in NAMES:
        groups = _column_groups(sheet, names)
        if len(groups) == 1:
            return names, groups
    return DIVIDED, _column_groups(sheet, DIVIDED)


def _column_groups(sheet: TableElement, names: int) -> list[list[int]]:
    head = _width(sheet, 0, names) + GAP
    groups: list[list[int]] = [[]]
    used = head
    for column in range(1, len(sheet.columns)):
        width = min(_width(sheet, column, names), WIDTH // 2) + GAP
        if groups[-1] and used + width > WIDTH:
            groups.append([])
            used = head
        groups[-1].append(column)
        used += width
    return groups


def _width(sheet: TableElement, column: int, names: int) -> int:
    rows = [folded(row[0], names) if column == 0 else row[column] for row in sheet.rows]
    return max(len(line) for cell in (sheet.columns[column], *rows) for line in cell.split("\n"))
