"""The report for a terminal of 80 columns or more."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Group, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from evaluation.advice import ModelAdvice
from evaluation.labels import folded
from evaluation.report.contents import Report
from evaluation.report.overview import drive_command, overview_sheet
from evaluation.report.sheets import Sheet
from evaluation.report.tables import condition_sheet
from evaluation.report.verdict import SAID, Finding, limits_question, verdict

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
    for sheet in (overview_sheet(report), condition_sheet(report.conditions)):
        parts += [] if sheet is None else to_rich(sheet)
    pick = None if report.transfer is None else report.transfer.pick
    if pick is not None and (command := drive_command(report, pick, folder=folder)) is not None:
        told = Text.assemble(("Drive with the chosen controller: ", "bold"), command)
        told.no_wrap, told.overflow = True, "ignore"  # a line of the terminal may break; one that is copied may not
        parts.append(Group(told))
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
    for title, notes in (("Notes", report.notes), ("Not shown", _absent(report))):
        if notes:
            parts.append(Group(Text(title, style="bold"), *(Text(f"- {note}") for note in notes)))
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


def _sheets(report: Report) -> list[Sheet]:
    from evaluation.report.sections import sections  # brings matplotlib

    shown = [section for section in sections(report) if not section.background]
    return [sheet for section in shown for sheet in section.sheets if not sheet.code]


def _absent(report: Report) -> list[str]:
    from evaluation.report.sections import sections  # brings matplotlib

    return [sentence for section in sections(report) for sentence in section.absent]


def _verdict(report: Report) -> list[RenderableType]:
    return [Text(report.title, style="bold"), *findings_lines(verdict(report))]


def findings_lines(findings: Sequence[Finding]) -> list[RenderableType]:
    """Return questions and their answers."""
    return [
        Group(Text(finding.question, style="bold cyan"), *(_indented(answer) for answer in finding.answers))
        for finding in findings
    ]


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
