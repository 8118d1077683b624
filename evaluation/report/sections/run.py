"""How the run was made: failures with reasons, settings, versions, computing times."""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import date
from typing import Any

from evaluation.report.document import Options, Part
from evaluation.report.elements import Item, Section, TableElement, present
from evaluation.results import ComparisonResults, Failure

SHORTEST = 0.05
"""Seconds below which the time of a step is left out."""


def section(report: ComparisonResults) -> Section | None:
    """Return failures, settings, versions and times; None if nothing is known."""
    timings = {cell: round(seconds, 2) for cell, seconds in report.timings.items() if seconds >= SHORTEST}
    named = (
        ("Settings", report.settings),
        ("Versions", report.versions),
        (f"Computing times (s) of steps above {SHORTEST:g} s", timings),
    )
    sheets: list[Item] = present(failure_table(report))
    sheets += [
        TableElement(title, ("name", "value"), tuple(flat(values)), details=True, prose=True)
        for title, values in named
        if values
    ]
    return Section("This run", sheets, background=True) if sheets else None


def failure_table(report: ComparisonResults) -> TableElement | None:
    """Return the steps that failed, and why; None if none did."""
    rows = tuple((failure.step, failure.reason) for failure in report.all_failures)
    return TableElement("Failed steps", ("step", "reason"), rows, prose=True) if rows else None


def flat(values: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """Return keys and values; nested values have a dotted key."""
    rows: list[tuple[str, str]] = []
    for key, value in values.items():
        if isinstance(value, Mapping):
            rows += flat(value, f"{prefix}{key}.")
        else:
            text = value if isinstance(value, str) else json.dumps(value, default=str)
            rows.append((f"{prefix}{key}", text))
    return rows


class TimingsPart(Part):
    """Seconds of each step, and the day of the last computed one, in UTC: they differ between two equal runs."""

    cells: dict[str, float]
    finished_on: date | None


class RunPart(Part):
    """How the run was made: failed steps with reasons, the experiment with every name resolved, versions."""

    failures: tuple[Failure, ...]
    settings: Options
    versions: dict[str, str]

    @classmethod
    def of(cls, report: ComparisonResults) -> RunPart:
        """Return how a report was made."""
        return cls.made_of(report, failures=report.all_failures)
