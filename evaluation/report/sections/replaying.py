"""One trial of a controller on every system, to watch."""

from __future__ import annotations

from evaluation.report.absences import of_replay
from evaluation.report.cards import worst_trials
from evaluation.report.contents import Report
from evaluation.report.pictures import traces_picture
from evaluation.report.replay import replay
from evaluation.report.sections.section import Section, present


def section(report: Report) -> Section | None:
    """Return the replay and the traces; None without controllers."""
    matrix, summary = report.matrix, report.transfer
    if matrix is None or summary is None:
        return None
    shown = replay(matrix, first=summary.pick, watched=worst_trials(report.exploitability, matrix))
    items = [] if shown is None else present(shown, traces_picture(matrix))
    return Section("Replay", items, absent=of_replay(report, shown))
