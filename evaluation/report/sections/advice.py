"""What limits the best model, and what to record next."""

from __future__ import annotations

from evaluation.report.contents import Report
from evaluation.report.sections.section import Section
from evaluation.report.tables import advice_sheet


def section(report: Report) -> Section | None:
    """Return the advice; None without any."""
    if report.advice is None or not report.advice.remarks:
        return None
    return Section("Advice", [advice_sheet(report.advice)], background=True)
