"""A page as Markdown: answers, tables, and links to the files of its figures."""

from __future__ import annotations

import re
from collections.abc import Iterator

from evaluation.report.elements import Cards, FigureElement, Fold, Page, Section, TableElement
from sysid_evo.errors import printable

SPECIAL = re.compile(r"([\\`*_{}\[\]<>|#])")


def story_to_markdown(story: Page, *, figures: str = "") -> str:
    """Return a page as Markdown; ``figures`` is the folder of the SVG files, empty to leave them out."""
    return "\n\n".join(_parts(story, figures)) + "\n"


def sheet_to_markdown(sheet: TableElement) -> str:
    """Return one table, the lines of a cell below each other, the command of a row in a last column."""
    heads = [_cell(head, " ") for head in sheet.columns]
    rule = [":--" if place == 0 or sheet.prose else "--:" for place in range(len(heads))]
    rows = [[*map(_cell, row)] for row in sheet.rows]
    if any(sheet.commands):
        heads, rule = [*heads, "command"], [*rule, ":--"]
        rows = [[*row, _code(command) if command else ""] for row, command in zip(rows, sheet.commands, strict=True)]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (heads, rule, *rows))


def _parts(story: Page, figures: str) -> Iterator[str]:
    yield f"# {_text(story.title)}"
    yield from (_text(line) for line in (story.facts, *story.warnings) if line)
    for one in story.headlines:
        yield f"**{_text(one.question)}** {_text(one.answer)}. {_text(one.sentence)}"
        if one.command:
            yield f"    {one.command}"
    for finding in story.findings:
        yield f"**{_text(finding.question)}**"
        yield "\n".join(f"- {_text(answer)}" for answer in finding.sentences)
    if story.figure is not None and figures:
        yield from _figure(story.figure, figures, "##")
    if story.overview is not None:
        yield from _sheet(story.overview, "##")
    for section in story.sections:
        yield from _section(section, figures)


def _section(section: Section, figures: str) -> Iterator[str]:
    yield f"## {_text(section.title)}"
    yield from (_text(paragraph) for paragraph in (*section.paragraphs, *section.absent))
    for item in section.flat:
        if isinstance(item, TableElement):
            yield from _sheet(item, "###")
        elif isinstance(item, Cards):
            yield f"### {_text(item.title)}"
            for card in item.cards:
                yield f"**{_text(card.title)}** {_text(card.verdict)}"
                if card.sentences:
                    yield "\n".join(f"- {_text(sentence)}" for sentence in card.sentences)
        elif isinstance(item, FigureElement) and figures:
            yield from _figure(item, figures, "###")
        elif isinstance(item, Fold):
            yield f"### {_text(item.title)}"


def _figure(item: FigureElement, figures: str, level: str) -> Iterator[str]:
    yield f"{level} {_text(item.title)}"
    yield "\n".join(f"![{_text(panel.title or item.title)}]({figures}/{panel.wide.key}.svg)" for panel in item.panels)
    yield _text(item.caption)


def _sheet(sheet: TableElement, level: str) -> Iterator[str]:
    yield f"{level} {_text(sheet.title)}"
    yield sheet_to_markdown(sheet)
    if sheet.note:
        yield _text(sheet.note)


def _cell(text: str, joint: str = "<br>") -> str:
    return joint.join(_text(line) for line in text.split("\n"))


def _code(text: str) -> str:
    return "`" + printable(text).replace("|", "\\|") + "`"


def _text(text: str) -> str:
    return SPECIAL.sub(r"\\\1", printable(text))
