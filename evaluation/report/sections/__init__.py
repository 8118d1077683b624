"""The sections of a report, in the order in which they are read; a further one is a module and a line here."""

from __future__ import annotations

from collections.abc import Callable

from evaluation.report.contents import Report
from evaluation.report.sections import (
    advice,
    behaviour,
    data,
    exploitability,
    failures,
    forecast,
    prediction,
    replaying,
    settings,
    transfer,
)
from evaluation.report.sections.section import Section

SECTIONS: tuple[Callable[[Report], Section | None], ...] = (
    prediction.section,
    advice.section,
    transfer.section,
    forecast.section,
    behaviour.section,
    replaying.section,
    exploitability.section,
    failures.section,
    data.section,
    settings.section,
)


def sections(report: Report) -> list[Section]:
    """Return the parts of the report after the verdict, without those that have nothing to show."""
    return [section for make in SECTIONS if (section := make(report)) is not None]


__all__ = ["SECTIONS", "Section", "sections"]
