"""What could not be computed."""

from __future__ import annotations

from evaluation.report.contents import Report
from evaluation.report.sections.section import Section
from evaluation.report.tables import failure_sheet


def section(report: Report) -> Section | None:
    """Return what failed, and why; None if nothing did."""
    return Section("Failures", [failure_sheet(report)]) if report.all_failures else None
