"""The content of a report in its order: pages and Markdown are made of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from evaluation.report.contents import Report
from evaluation.report.headlines import Headline, headlines
from evaluation.report.overview import overview_sheet
from evaluation.report.sections import Section, sections
from evaluation.report.sheets import Sheet
from evaluation.report.verdict import Finding, verdict


@dataclass(frozen=True)
class Story:
    """Answers in a few words, then in sentences, a short table, and the sections."""

    title: str
    headlines: Sequence[Headline]
    findings: Sequence[Finding]
    overview: Sheet | None
    sections: Sequence[Section]

    @classmethod
    def of(cls, report: Report) -> Story:
        """Tell what a report holds."""
        return cls(report.title, headlines(report), verdict(report), overview_sheet(report), sections(report))
