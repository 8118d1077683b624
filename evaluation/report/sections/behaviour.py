"""How every controller goes about its task."""

from __future__ import annotations

from evaluation.report.contents import Report
from evaluation.report.sections.section import Section, present
from evaluation.report.tables import behaviour_sheet, manner_sheet


def section(report: Report) -> Section | None:
    """Return what controllers do, in sentences and numbers; None if no trial of one was recorded."""
    if not report.manners or report.matrix is None:
        return None
    robot = report.matrix.robot
    return Section("Behaviour", present(manner_sheet(report.manners, robot), behaviour_sheet(report.manners, robot)))
