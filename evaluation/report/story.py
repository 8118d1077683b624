"""What is told, in the order in which it is told: pages, Markdown and LaTeX are made of it."""

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

    @property
    def sheets(self) -> list[tuple[str, Sheet]]:
        """All tables, each with the anchor of its section."""
        first = [] if self.overview is None else [("overview", self.overview)]
        return first + [(section.anchor, sheet) for section in self.sections for sheet in section.sheets]
