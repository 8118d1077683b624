"""Writes the other forms of a report beside it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from evaluation.report.contents import Report
from evaluation.report.formats.markdown import story_to_markdown
from evaluation.report.story import Story
from sysid_evo.errors import InvalidArgument
from sysid_evo.files import write_atomically

TEXT, FIGURES = "report.md", "figures"


def write_format(report: Report, name: str, folder: str | Path) -> tuple[Path, ...]:
    """Write the form ``name`` of a report into ``folder`` and return the files. Raises `InvalidArgument`."""
    if name not in FORMATS:
        raise InvalidArgument(f"format: expected one of {', '.join(FORMATS)}, got {name!r}")
    return FORMATS[name](Story.of(report), Path(folder))


def _markdown(story: Story, folder: Path) -> tuple[Path, ...]:
    drawn = _figures(story, folder)
    return (_text(folder / TEXT, story_to_markdown(story, figures=FIGURES)), *drawn)


def _figures(story: Story, folder: Path) -> tuple[Path, ...]:
    pictures = [picture for section in story.sections for picture in section.pictures]
    drawings = [panel.wide for picture in pictures for panel in picture.panels]
    return tuple(_text(folder / FIGURES / f"{drawing.key}.svg", drawing.file) for drawing in drawings)


def _text(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    return write_atomically(path, lambda file: file.write_text(text, encoding="utf-8"))


FORMATS: dict[str, Callable[[Story, Path], tuple[Path, ...]]] = {
    "markdown": _markdown,
    "svg": _figures,
}
"""Names of the forms, and what writes them."""
