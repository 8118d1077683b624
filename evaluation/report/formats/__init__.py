"""The report in other forms: Markdown, and every figure as an SVG file."""

from evaluation.report.formats.markdown import story_to_markdown, to_markdown
from evaluation.report.formats.write import FORMATS, write_format

__all__ = ["FORMATS", "story_to_markdown", "to_markdown", "write_format"]
