"""Writes a page in every form; leaves alone what is up to date."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path

from evaluation.report.elements import Story
from evaluation.report.render.markdown import story_to_markdown
from evaluation.results import Report
from sysid_evo.errors import InvalidArgument
from sysid_evo.files import write_atomically
from sysid_evo.version import versions

EVALUATION = Path(__file__).parents[1]
"""The package whose sources decide how a page looks."""


def _mark(of: str, text: str) -> str:
    """Return the last line of a page: what it was made of, and by which program."""
    made_of = hashlib.sha256(json.dumps([of, text, versions()]).encode())
    for file in sorted(EVALUATION.rglob("*")):
        if file.suffix in (".py", ".j2", ".js", ".css"):
            made_of.update(file.read_bytes())
    return f"\n<!-- made of {made_of.hexdigest()} -->\n"


def _end(file: Path, length: int) -> str:
    """Return the last ``length`` bytes of a file as text, nothing if there is none."""
    try:
        with file.open("rb") as stream:
            stream.seek(max(0, file.stat().st_size - length))
            return stream.read().decode(errors="replace")
    except OSError:
        return ""


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
