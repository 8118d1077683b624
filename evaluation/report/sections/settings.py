"""With what the report was made: models and their parameters, settings, versions, times."""

from __future__ import annotations

from evaluation.report.contents import Report
from evaluation.report.sections.section import Section
from evaluation.report.tables import key_sheet, model_sheet

SHORTEST = 0.05
"""Seconds below which the time of a cell is left out."""


def section(report: Report) -> Section | None:
    """Return models, settings, versions and times; None if none is known."""
    named = (
        ("Settings", report.settings),
        ("Versions", report.versions),
        (f"Timings (s) from {SHORTEST:g} s", _timings(report)),
    )
    sheets = [model_sheet(report)] if report.models else []
    sheets += [key_sheet(title, values) for title, values in named if values]
    return Section("Settings", sheets, background=True) if sheets else None


def _timings(report: Report) -> dict[str, float]:
    return {cell: round(seconds, 2) for cell, seconds in report.timings.items() if seconds >= SHORTEST}
