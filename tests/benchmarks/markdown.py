"""Tables of the commands that measure: printed, and written for the pages of results with ``--markdown FILE``."""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from pathlib import Path

from rich.console import Console
from rich.table import Table

ROOT = Path(__file__).parents[2]
OPTION = "--markdown"


def add_markdown(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--markdown FILE``."""
    parser.add_argument(OPTION, type=Path, metavar="FILE", help="also write the table there, for docs/results/tables")


def print_tables(tables: Sequence[Table], file: Path | None, console: Console | None = None) -> None:
    """Print tables, and write them to ``file`` if there is one."""
    for table in tables:
        (console or Console()).print(table)
    if file is not None:
        write_markdown(file, "\n\n".join(to_markdown(table) for table in tables))


def thousandths(values: Iterable[float]) -> str:
    """Return numbers in one cell, to three places and without a leading zero: ``.129 .466 1.250``."""
    return " ".join(f"{value:.3f}".removeprefix("0") for value in values)


def per_cents(shares: Iterable[float]) -> str:
    """Return shares in one cell, in whole per cent: ``93 / 94 / 88``."""
    return " / ".join(f"{100.0 * share:.0f}" for share in shares)


def to_markdown(table: Table) -> str:
    """Return a table as Markdown."""
    rows = zip(*(column.cells for column in table.columns), strict=True)
    lines = [[column.header for column in table.columns], ["---"] * len(table.columns), *rows]
    return "\n".join("| " + " | ".join(str(cell).replace("\n", "<br>") for cell in line) + " |" for line in lines)


def write_markdown(file: Path, text: str) -> None:
    """Write ``text`` below a first line with the command, the commit and the date."""
    words, skip = ["python"], False
    for word in sys.orig_argv[1:]:
        if not skip and word != OPTION:
            words.append(word)
        skip = word == OPTION
    commit = subprocess.run(
        ["git", "rev-parse", "--short=9", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.strip()
    file.write_text(f"<!-- {' '.join(words)}; commit {commit}; {datetime.now(UTC).date()} -->\n\n{text}\n")
