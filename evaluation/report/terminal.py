"""The report for a terminal of 80 columns or more."""

from __future__ import annotations

from rich.console import Group, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from evaluation.labels import folded
from evaluation.report import tables as sheets_of
from evaluation.report.contents import Report
from evaluation.report.sheets import Sheet
from evaluation.report.verdict import main_horizon, verdict

WIDTH = 80
GAP = 2
NAME = 20


def tables(report: Report) -> list[RenderableType]:
    """Return the verdict and the main tables as rich renderables, each at most 80 columns wide."""
    parts: list[RenderableType] = [Text(report.title, style="bold")]
    for finding in verdict(report):
        answers = [Padding(Text(answer), (0, 0, 0, 2)) for answer in finding.answers]
        parts.append(Group(Text(finding.question, style="bold cyan"), *answers))
    for sheet in _sheets(report):
        parts += to_rich(sheet)
    if report.exploitability:
        parts.append(Group(*(Text(model.sentence) for model in report.exploitability)))
    if report.notes:
        parts.append(Group(Text("Notes", style="bold"), *(Text(f"- {note}") for note in report.notes)))
    return parts


def brief(report: Report) -> list[RenderableType]:
    """Return the verdict."""
    return tables(report)[: 1 + len(verdict(report))]


def to_rich(sheet: Sheet) -> list[RenderableType]:
    """Return ``sheet`` as one table, or as several with the same rows where it is wider than 80 columns."""
    parts: list[RenderableType] = []
    for number, group in enumerate(_column_groups(sheet)):
        continued = " (continued)" if number else ""
        parts.append(Text(sheet.title + continued, style="bold"))
        table = Table(box=None, padding=(0, 1))
        chosen = [0, *group]
        for column in chosen:
            # names and prose may wrap; numbers never do
            wraps = column == 0 or _width(sheet, column) > WIDTH // 2
            table.add_column(
                Text(sheet.columns[column]),
                justify="left" if wraps else "right",
                no_wrap=not wraps,
                overflow="fold",
                vertical="top",
            )
        for row in sheet.rows:
            table.add_row(Text(folded(row[0], NAME)), *(Text(row[column]) for column in group))
        parts.append(table)
    if sheet.note:
        parts.append(Padding(Text(sheet.note, style="dim"), (0, 0, 1, 1)))
    return parts


def _sheets(report: Report) -> list[Sheet]:
    sheets = []
    if report.prediction is not None:
        sheets.append(sheets_of.prediction_sheet(report.prediction))
        ends = (main_horizon(report.prediction), *report.prediction.horizons[-1:])
        chosen = [horizon for horizon in dict.fromkeys(ends) if horizon in report.prediction.horizons]
        sheets += [sheets_of.channel_sheet(report.prediction, horizon) for horizon in chosen]
    if report.matrix is not None and report.transfer is not None:
        sheets.append(sheets_of.transfer_sheet(report.matrix))
        sheets.append(sheets_of.controller_sheet(report.matrix, report.transfer))
    if report.exploitability:
        sheets.append(sheets_of.exploitability_sheet(report.exploitability))
        if report.exploitability[0].probes:
            sheets.append(sheets_of.probe_sheet(report.exploitability))
    if report.all_failures:
        sheets.append(sheets_of.failure_sheet(report))
    return sheets


def _column_groups(sheet: Sheet) -> list[list[int]]:
    """Divide the columns after the first into groups that fit beside it."""
    head = _width(sheet, 0) + GAP
    groups: list[list[int]] = [[]]
    used = head
    for column in range(1, len(sheet.columns)):
        width = min(_width(sheet, column), WIDTH // 2) + GAP
        if groups[-1] and used + width > WIDTH:
            groups.append([])
            used = head
        groups[-1].append(column)
        used += width
    return groups


def _width(sheet: Sheet, column: int) -> int:
    names = column == 0
    cells = [sheet.columns[column], *(folded(row[0], NAME) if names else row[column] for row in sheet.rows)]
    return max(len(line) for cell in cells for line in cell.split("\n"))
