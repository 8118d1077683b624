"""Writes a study into a folder: a document, Markdown, and a page."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from evaluation.report.formats import story_to_markdown
from evaluation.report.page import page_of
from evaluation.report.sheets import Sheet
from evaluation.report.story import Story
from evaluation.report.study.document import study_document
from evaluation.report.study.telling import study_story
from evaluation.study import StudyResults
from sysid_evo.files import write_atomically

DOCUMENT, MARKDOWN, PAGE = "study.json", "study.md", "study.html"


def save_study(results: StudyResults, folder: str | Path) -> tuple[Path, ...]:
    """Write ``study.json``, ``study.md`` and ``study.html`` into ``folder`` and return their paths."""
    story = study_story(results)
    texts = {
        DOCUMENT: json.dumps(study_document(results), indent=1, allow_nan=False, ensure_ascii=False) + "\n",
        MARKDOWN: story_to_markdown(_short(story)),
        PAGE: page_of(story),
    }
    return tuple(_written(Path(folder) / name, text) for name, text in texts.items())


def _written(path: Path, text: str) -> Path:
    return write_atomically(path, lambda file: file.write_text(text, encoding="utf-8"))


def _short(story: Story) -> Story:
    """Return a story without what the page folds away."""
    sections = [
        replace(one, items=[item for item in one.items if not (isinstance(item, Sheet) and item.details)])
        for one in story.sections
    ]
    return replace(story, sections=[one for one in sections if one.items or one.absent])
