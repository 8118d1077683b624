"""The report for a terminal of 80 columns or more."""

from __future__ import annotations

from pathlib import Path

from rich.console import Group, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from evaluation.advice import ModelAdvice
from evaluation.labels import folded
from evaluation.report import tables as sheets_of
from evaluation.report.contents import Report
from evaluation.report.forecasting import forecast_sheet, model_forecast_sheet
from evaluation.report.overview import drive_command, overview_sheet
from evaluation.report.predicting import main_horizon
from evaluation.report.sheets import Sheet
from evaluation.report.verdict import SAID, limits_question, verdict

WIDTH = 80
GAP = 2
NAMES = (28, 20, 13)
"""Widths to which the names of rows are folded: the first that saves dividing the table."""
DIVIDED = 20
"""And the width in a table that is divided all the same."""
SHOWN_FAILURES = 5


def brief(report: Report, *, folder: str | Path = "") -> list[RenderableType]:
    """Return the verdict and one short table: what fits on a screen.

    ``folder``, the run folder, is put before the file of the chosen controller. The path of the report is not
    in it: whoever saves the report prints it, last.
    """
    parts = _verdict(report)
    if report.all_failures:
        shown, count = report.all_failures[:SHOWN_FAILURES], len(report.all_failures)
        reasons = [_indented(f"{failure.what}: {failure.reason.splitlines()[0]}") for failure in shown]
        more = [_indented(f"and {count - len(shown)} more, in the report")] if count > len(shown) else []
        parts.append(Group(*reasons, *more))
    for sheet in (overview_sheet(report), sheets_of.condition_sheet(report.conditions)):
        parts += [] if sheet is None else to_rich(sheet)
    pick = None if report.transfer is None else report.transfer.pick
    if pick is not None and (command := drive_command(report, pick, folder=folder)) is not None:
        parts.append(Text.assemble(("Drive with the chosen controller: ", "bold"), command, overflow="fold"))
    return parts


def tables(report: Report) -> list[RenderableType]:
    """Return the verdict and all main tables as rich renderables, each at most 80 columns wide."""
    parts = _verdict(report)
    if report.advice is not None and len(report.advice.remarks) > SAID:
        parts += advice_lines(report.advice)
    for sheet in _sheets(report):
        parts += to_rich(sheet)
    if report.exploitability:
        parts.append(Group(*(Text(model.sentence) for model in report.exploitability)))
    if report.notes:
        parts.append(Group(Text("Notes", style="bold"), *(Text(f"- {note}") for note in report.notes)))
    return parts


def advice_lines(advice: ModelAdvice) -> list[RenderableType]:
    """Return what limits a model as a list, the most important first; nothing where there was no model."""
    if not advice.model:
        return []
    if not advice.remarks:
        return [Text(f"Nothing stands out that limits {advice.model}. Judged on {advice.judged_on}.")]
    bullets = Table.grid(padding=(0, 1))
    for remark in advice.remarks:
        bullets.add_row(Text(" -"), Text(remark.sentence))
    judged = Padding(Text(f"Judged on {advice.judged_on}.", style="dim"), (0, 0, 0, 1))
    return [Text(limits_question(advice), style="bold cyan"), bullets, judged]


def to_rich(sheet: Sheet) -> list[RenderableType]:
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
                justify="left" if wraps else "right",
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


def _sheets(report: Report) -> list[Sheet]:
    sheets = []
    if report.prediction is not None:
        sheets.append(sheets_of.prediction_sheet(report.prediction))
        found = (
            sheets_of.coverage_sheet(report.prediction),
            sheets_of.difference_sheet(report.prediction),
            sheets_of.region_sheet(report.prediction),
            sheets_of.residual_sheet(report.prediction),
            sheets_of.episode_error_sheet(report.prediction),
            sheets_of.fit_sheet(report.prediction),
        )
        sheets += [sheet for sheet in found if sheet is not None]
        ends = (main_horizon(report.prediction), *report.prediction.horizons[-1:])
        chosen = [horizon for horizon in dict.fromkeys(ends) if horizon in report.prediction.horizons]
        sheets += [sheets_of.channel_sheet(report.prediction, horizon) for horizon in chosen]
    if (conditions := sheets_of.condition_sheet(report.conditions)) is not None:
        sheets.append(conditions)
    if report.matrix is not None and report.transfer is not None:
        sheets.append(sheets_of.transfer_sheet(report.matrix))
        sheets.append(sheets_of.controller_sheet(report.matrix, report.transfer))
        measured = sheets_of.measure_sheet(report.matrix), sheets_of.finalist_sheet(report.matrix)
        expected = forecast_sheet(report), model_forecast_sheet(report)
        sheets += [sheet for sheet in (*measured, *expected) if sheet is not None]
    if report.exploitability:
        sheets.append(sheets_of.exploitability_sheet(report.exploitability))
        if report.exploitability[0].probes:
            sheets.append(sheets_of.probe_sheet(report.exploitability))
    if report.all_failures:
        sheets.append(sheets_of.failure_sheet(report))
    return sheets


def _verdict(report: Report) -> list[RenderableType]:
    parts: list[RenderableType] = [Text(report.title, style="bold")]
    for finding in verdict(report):
        answers = [_indented(answer) for answer in finding.answers]
        parts.append(Group(Text(finding.question, style="bold cyan"), *answers))
    return parts


def _indented(text: str) -> Padding:
    return Padding(Text(text), (0, 0, 0, 2))


def _layout(sheet: Sheet) -> tuple[int, list[list[int]]]:
    """Return the width of the names, and the other columns in groups that fit beside them: one, if possible."""
    for names in NAMES:
        groups = _column_groups(sheet, names)
        if len(groups) == 1:
            return names, groups
    return DIVIDED, _column_groups(sheet, DIVIDED)


def _column_groups(sheet: Sheet, names: int) -> list[list[int]]:
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


def _width(sheet: Sheet, column: int, names: int) -> int:
    rows = [folded(row[0], names) if column == 0 else row[column] for row in sheet.rows]
    return max(len(line) for cell in (sheet.columns[column], *rows) for line in cell.split("\n"))
