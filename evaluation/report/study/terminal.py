"""A study for a terminal of 80 columns or more."""

from __future__ import annotations

from rich.console import RenderableType
from rich.text import Text

from evaluation.report.study.tables import prediction_sheet
from evaluation.report.study.telling import study_story
from evaluation.report.terminal import findings_lines, to_rich
from evaluation.report.verdict import Finding
from evaluation.study import StudyResults


def study_brief(results: StudyResults, *, verbose: bool = False) -> list[RenderableType]:
    """Return the answers and the short table; with ``verbose`` every table that the page does not fold away."""
    story = study_story(results)
    parts: list[RenderableType] = [
        Text(story.title, style="bold"),
        *findings_lines([Finding(one.question, (f"{one.answer}. {one.sentence}",)) for one in story.headlines]),
        *findings_lines(story.findings),
    ]
    short = story.overview or prediction_sheet(results)
    parts += [] if short is None else to_rich(short)
    if verbose:
        for section in story.sections:
            for sheet in section.sheets:
                parts += [] if sheet.details else to_rich(sheet)
    return parts
