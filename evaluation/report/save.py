"""Writes a page in every form; leaves alone what is up to date."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from evaluation.report.elements import Page
from evaluation.report.render.html import page_of
from evaluation.report.render.markdown import story_to_markdown
from evaluation.report.render.svg import svg_file
from sysid_evo.errors import InvalidArgument
from sysid_evo.files import write_atomically
from sysid_evo.version import versions

TEXT, FIGURES = "report.md", "figures"

EVALUATION = Path(__file__).parents[1]
"""The package whose sources determine the page."""


def json_text(document: Mapping[str, Any]) -> str:
    """Return the text of a strict document."""
    return json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def write_text(path: Path, text: str) -> Path:
    """Write a file whole, its folder too, and return its path."""
    return write_atomically(path, lambda file: file.write_text(text, encoding="utf-8"))


def write_format(story: Page, name: str, folder: str | Path) -> tuple[Path, ...]:
    """Write the form ``name`` of a report into ``folder`` and return the files. Raises `InvalidArgument`."""
    if name not in FORMATS:
        raise InvalidArgument(f"format: expected one of {', '.join(FORMATS)}, got {name!r}")
    return FORMATS[name](story, Path(folder))


def _markdown(story: Page, folder: Path) -> tuple[Path, ...]:
    drawn = _figures(story, folder)
    return (write_text(folder / TEXT, story_to_markdown(story, figures=FIGURES)), *drawn)


def _figures(story: Page, folder: Path) -> tuple[Path, ...]:
    pictures = [picture for section in story.sections for picture in section.pictures]
    pictures += [] if story.figure is None else [story.figure]
    drawings = [panel.wide for picture in pictures for panel in picture.panels]
    return tuple(write_text(folder / FIGURES / f"{drawing.key}.svg", svg_file(drawing)) for drawing in drawings)


FORMATS: dict[str, Callable[[Page, Path], tuple[Path, ...]]] = {
    "markdown": _markdown,
    "svg": _figures,
}
"""Functions that write further forms of a report, by name."""


def write_page(page: Path, story: Callable[[], Page], *, made_of: str = "", afresh: bool = False) -> Path:
    """Write an HTML page and return its path.

    ``made_of`` determines all that the page shows. If it is given, a page of the same results by the same program is
    left as it is, unless ``afresh``.
    """
    mark = ""
    if made_of:
        found = hashlib.sha256(json.dumps([made_of, versions()]).encode())
        for file in sorted(EVALUATION.rglob("*")):
            if file.suffix in (".py", ".j2", ".js", ".css", ".toml"):
                found.update(file.read_bytes())
        mark = f"\n<!-- made of {found.hexdigest()} -->\n"
    if mark and not afresh and page.is_file() and page.read_bytes().endswith(mark.encode()):
        return page
    return write_text(page, page_of(story()) + mark)
