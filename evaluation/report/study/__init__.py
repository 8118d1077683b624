"""A study as a page, as Markdown, for a terminal, and as strict JSON."""

from evaluation.report.study.document import study_document
from evaluation.report.study.save import save_study
from evaluation.report.study.telling import study_story
from evaluation.report.study.terminal import study_brief

__all__ = ["save_study", "study_brief", "study_document", "study_story"]
