"""The report in other forms: Markdown, LaTeX tables, and every figure as an SVG file."""

from evaluation.report.formats.latex import to_latex
from evaluation.report.formats.markdown import story_to_markdown, to_markdown
from evaluation.report.formats.write import FORMATS, write_format

__all__ = ["FORMATS", "story_to_markdown", "to_latex", "to_markdown", "write_format"]
