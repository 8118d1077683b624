"""The blocks of code of a page."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = {"README.md": ROOT / "README.md"} | {
    path.relative_to(DOCS).as_posix(): path for path in sorted(DOCS.rglob("*.md"))
}
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)


@dataclass(frozen=True)
class Block:
    """One block of code: its ``language`` (may be empty), its text, and the line of the page on which that begins."""

    page: str
    language: str
    text: str
    line: int


def blocks(page: str, language: str) -> list[Block]:
    """Return the blocks of ``page`` in this language, in order."""
    text = PAGES[page].read_text()
    found = [Block(page, m[1], m[2], text.count("\n", 0, m.start(2)) + 1) for m in FENCE.finditer(text)]
    return [block for block in found if block.language == language]


def program(page: str) -> str:
    """Return all Python of ``page`` as one module, every line where it stands on the page."""
    lines = [""] * len(PAGES[page].read_text().splitlines())
    for block in blocks(page, "python"):
        text = block.text.splitlines()
        lines[block.line - 1 : block.line - 1 + len(text)] = text
    whole = "\n".join(lines) + "\n"
    return re.sub(
        r"^from __future__ import annotations$", "", whole, flags=re.MULTILINE
    )  # it may stand at the top only


def commands(page: str) -> list[str]:
    """Return the lines of the blocks in sh, without remarks; lines that end in a backslash are joined."""
    text = "\n".join(block.text for block in blocks(page, "sh")).replace("\\\n", " ")
    lines = [re.sub(r"(^|\s)#.*", "", line).strip() for line in text.splitlines()]
    return [line for line in lines if line]
