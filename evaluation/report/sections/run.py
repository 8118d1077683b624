"""How the run was made: what failed, and why; models, settings, versions, times."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from evaluation.formatting import listed
from evaluation.report.elements import Section, TableElement
from evaluation.results import ComparisonResults

SHORTEST = 0.05
"""Seconds below which the time of a cell is left out."""


def section(report: ComparisonResults) -> Section | None:
    """Return models, settings, versions and times; None if none is known."""
    timings = {cell: round(seconds, 2) for cell, seconds in report.timings.items() if seconds >= SHORTEST}
    named = (
        ("Settings", report.settings),
        ("Versions", report.versions),
        (f"Timings (s) from {SHORTEST:g} s", timings),
    )
    sheets = [model_sheet(report)] if report.models else []
    sheets += [
        TableElement(title, ("name", "value"), tuple(flat(values)), details=True, prose=True)
        for title, values in named
        if values
    ]
    return Section("Settings", sheets, background=True) if sheets else None


def failures(report: ComparisonResults) -> Section | None:
    """Return what could not be computed, and why; None if nothing failed."""
    rows = tuple((failure.what, failure.reason) for failure in report.all_failures)
    return Section("Failures", [TableElement("Failed", ("what", "reason"), rows, prose=True)]) if rows else None


def model_sheet(report: ComparisonResults) -> TableElement:
    """The models and their hyper-parameters."""
    rows = [
        (model.name, model.family, model.knowledge, listed([f"{k} = {v}" for k, v in model.parameters.items()]))
        for model in report.models
    ]
    heads = ("model", "family", "knowledge", "hyper-parameters")
    return TableElement("Models", heads, tuple(rows), details=True, prose=True)


def flat(values: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """Return keys and values; what is nested gets a dotted key."""
    rows: list[tuple[str, str]] = []
    for key, value in values.items():
        if isinstance(value, Mapping):
            rows += flat(value, f"{prefix}{key}.")
        else:
            text = value if isinstance(value, str) else json.dumps(value, default=str)
            rows.append((f"{prefix}{key}", text))
    return rows
