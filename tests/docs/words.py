"""`python -m tests.docs.words`: count the words that only this project uses, in all that is read.

What they are, and what to say instead, is in ``words.toml``. Code, in pages too, is not counted. With ``--list``
every place is printed, with ``FOLDER ...`` only those in files below these folders.
"""

import argparse
import ast
import re
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from typer.testing import CliRunner

from sysid_evo.cli.app import app

ROOT = Path(__file__).parents[2]
PACKAGES = ("sysid_evo", "model_zoo", "evaluation", "hardware")
REPORT = "evaluation/report/"
LIST: dict[str, dict[str, str]] = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
"""Pattern and what to say instead, for all texts and for those of a kind or file alone."""
WORD = re.compile(r"[A-Za-z][A-Za-z'-]*")
CODE = re.compile(
    r"```.*?```|~~~.*?~~~|``[^`]*``|`[^`\n]*`|<[^>]*>|\]\([^)]*\)|[\w.]+\([^()\n]*\)|https?://\S+", re.DOTALL
)


@dataclass(frozen=True)
class Text:
    """What somebody reads, in ``line`` of ``file``; ``kind`` is docs, help, message, report, docstring or comment."""

    kind: str
    file: str
    line: int
    text: str

    def private(self) -> Iterator[tuple[int, str, str]]:
        """Yield line, word and what to say instead."""
        places = [name for name in LIST if name in ("everywhere", self.kind) or self.file.startswith(name)]
        plain = CODE.sub(lambda code: "\n" * code[0].count("\n"), self.text)
        for name in places:
            for found in _all_of(name, *LIST[name]).finditer(plain):
                better = list(LIST[name].values())[found.lastindex - 1]
                yield self.line + plain.count("\n", 0, found.start()), found[0], better

    def count(self) -> int:
        """Return how many words it has."""
        return len(WORD.findall(CODE.sub(" ", self.text)))


@lru_cache
def _all_of(name: str, *patterns: str) -> re.Pattern[str]:
    """Return one pattern with a group for each of a part of the list."""
    return re.compile(rf"\b(?:{'|'.join(f'({pattern})' for pattern in patterns)})\b", re.IGNORECASE)


def pages() -> Iterator[Text]:
    """Yield the pages and the README."""
    for path in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]:
        yield Text("docs", str(path.relative_to(ROOT)), 1, path.read_text(encoding="utf-8"))


def help_texts() -> Iterator[Text]:
    """Yield the help of every command as it is printed."""
    waiting: list[list[str]] = [[]]
    while waiting:
        words = waiting.pop(0)
        shown = CliRunner(env={"COLUMNS": "80"}).invoke(app, [*words, "--help"]).output
        yield Text("help", " ".join(["sysid-evo", *words]), 1, re.sub(r"[│╭╮╰╯─]", " ", shown))
        if "COMMAND" in shown:
            waiting += [[*words, found] for found in re.findall(r"^│ ([a-z][a-z-]*) ", shown, re.MULTILINE)]


def code_texts() -> Iterator[Text]:
    """Yield docstrings, comments and messages of the product, and what its pages show."""
    for path in sorted(found for package in PACKAGES for found in (ROOT / package).rglob("*.py")):
        source, file = path.read_text(encoding="utf-8"), str(path.relative_to(ROOT))
        tree = ast.parse(source)
        docstrings = set(map(id, _docstrings(tree)))
        said = "report" if file.startswith(REPORT) else "message"
        for node in ast.walk(tree):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                if id(node) in docstrings:
                    yield Text("docstring", file, node.lineno, node.value)
                elif " " in node.value:
                    yield Text(said, file, node.lineno, node.value)
        for number, line in enumerate(source.splitlines(), start=1):
            if "#" in line:  # a text with this sign is read twice, which is faster than to parse again
                yield Text("comment", file, number, line.partition("#")[2])


def _docstrings(tree: ast.AST) -> Iterator[ast.Constant]:
    """Yield the texts that stand alone, which describe what they stand in or after."""
    for node in ast.walk(tree):
        match node:
            case ast.Expr(value=ast.Constant(value=str()) as text):
                yield text


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the share of private words by kind of text; return 1 if places were asked for and found."""
    parser = argparse.ArgumentParser(prog="python -m tests.docs.words", description=__doc__)
    parser.add_argument("folders", nargs="*", metavar="FOLDER", help="files and folders, from the root of the project")
    parser.add_argument("--list", action="store_true", help="print every place")
    asked = parser.parse_args(arguments)
    words, private, which = Counter[str](), Counter[str](), Counter[str]()
    for text in [*pages(), *help_texts(), *code_texts()]:
        if not asked.folders or text.file.startswith(tuple(asked.folders)):
            words[text.kind] += text.count()
            for line, word, better in text.private():
                private[text.kind] += 1
                which[word.lower()] += 1
                if asked.list:
                    sys.stdout.write(f"{text.file}:{line}: {word} -> {better}\n")
    for kind, count in words.items():
        sys.stdout.write(
            f"{kind:10} {count:7} words, {private[kind]:5} private, {1e4 * private[kind] / count:6.1f} per 10,000\n"
        )
    sys.stdout.write(f"most often: {', '.join(f'{word} {count}' for word, count in which.most_common(15))}\n")
    return int(asked.list and bool(which))


if __name__ == "__main__":
    sys.exit(main())
