"""A change of one line of the product, which some test must notice."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Change:
    """Replace ``old``, which stands exactly once in ``file``, by ``new``; one of ``tests`` must then fail.

    ``breaks`` says what the product does wrong with it. ``tests`` are what pytest takes: files, or
    ``file::test``.
    """

    breaks: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]

    def stale(self, root: Path) -> str:
        """Return why the change no longer fits the tree at ``root``; empty if it does."""
        path = root / self.file
        if not path.is_file():
            return f"there is no {self.file}"
        count = path.read_text(encoding="utf-8").count(self.old)
        if count != 1:
            return f"expected its text once in {self.file}, found it {count} times"
        lacking = [test for test in self.tests if not _exists(root, test)]
        if lacking or not self.tests:
            return f"there is no {', '.join(lacking) or 'test named'}"
        return "" if self.old != self.new else "it changes nothing"

    def changed(self, root: Path) -> str:
        """Return the text of the file with the change."""
        return (root / self.file).read_text(encoding="utf-8").replace(self.old, self.new)


def _exists(root: Path, test: str) -> bool:
    file, _, name = test.partition("::")
    path = root / file
    return path.is_file() and (not name or f"def {name}(" in path.read_text(encoding="utf-8"))
