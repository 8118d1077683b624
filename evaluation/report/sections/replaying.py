"""One trial of a controller on every system, to watch."""

from __future__ import annotations

from evaluation.report.contents import Report
from evaluation.report.replay import replay
from evaluation.report.sections.section import Section


def section(report: Report) -> Section | None:
    """Return the replay; None if no trial was kept."""
    matrix, summary = report.matrix, report.transfer
    if matrix is None or summary is None:
        return None
    shown = replay(matrix, first=summary.pick)
    return None if shown is None else Section("Replay", [shown])
