"""How the run was made: failures, settings, versions, times."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from evaluation.report.elements import Section, Sheet
from evaluation.report.sections.models import model_sheet
from evaluation.results import Report

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


def failures_section(report: Report) -> Section | None:
    """Return what failed, and why; None if nothing did."""
    return Section("Failures", [failure_sheet(report)]) if report.all_failures else None


def failure_sheet(report: Report) -> Sheet:
    """What could not be computed, and why."""
    rows = tuple((failure.what, failure.reason) for failure in report.all_failures)
    return Sheet("Failed", ("what", "reason"), rows, prose=True)


def key_sheet(title: str, values: Mapping[str, Any]) -> Sheet:
    """Keys and values; what is nested gets a dotted key."""
    return Sheet(title, ("name", "value"), tuple(_flat(values)), details=True, prose=True)


def _flat(values: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    rows: list[tuple[str, str]] = []
    for key, value in values.items():
        if isinstance(value, Mapping):
            rows += _flat(value, f"{prefix}{key}.")
        else:
            text = value if isinstance(value, str) else json.dumps(value, default=str)
            rows.append((f"{prefix}{key}", text))
    return rows
