"""`python -m tests.mutation`: change one line of the product at a time and see which test notices.

Ends with 0 if at least 95 % of the changes are caught and every one could be tried, else with 1.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from tests.mutation.change import Change
from tests.mutation.changes import ALL
from tests.mutation.running import Outcome, try_changes

ROOT = Path(__file__).parents[2]
WIDTH = 220
"""Columns of the table where it is not printed on a terminal."""
ENOUGH = 0.95
"""Share of the changes that tests must catch."""


def main(arguments: Sequence[str] | None = None, *, root: Path = ROOT, changes: Sequence[Change] = ALL) -> int:
    """Try the changes that the arguments choose, print a table, and return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description=__doc__)
    parser.add_argument("--only", metavar="WORD", help="only changes with this word in their sentence or file")
    parser.add_argument("--list", action="store_true", help="list the changes and try none")
    chosen = parser.parse_args(arguments)
    out = Console(highlight=False, width=None if sys.stdout.isatty() else WIDTH)
    wanted = [c for c in changes if not chosen.only or chosen.only in c.breaks or chosen.only in c.file]
    if not wanted:
        out.print(f"No change has {chosen.only!r} in its sentence or file.")
        return 1
    if chosen.list:
        for change in wanted:
            out.print(f"{change.file}: {change.breaks}", markup=False)
        return 0
    outcomes = []
    with tempfile.TemporaryDirectory(prefix="sysid-evo-mutation-") as folder:
        for outcome in try_changes(root, Path(folder), wanted):
            outcomes.append(outcome)
            Console(stderr=True, highlight=False, soft_wrap=True).print(
                f"{len(outcomes)} of {len(wanted)}: {outcome.change.breaks}: {outcome.word}", markup=False
            )
    out.print(table(outcomes))
    caught = sum(bool(outcome.caught) for outcome in outcomes)
    out.print(f"{caught} of {len(outcomes)} caught, {caught / len(outcomes):.0%}; {ENOUGH:.0%} are enough.")
    return 0 if caught >= ENOUGH * len(outcomes) and not any(outcome.fault for outcome in outcomes) else 1


def table(outcomes: Sequence[Outcome]) -> Table:
    """Return what became of every change."""
    made = Table(box=None, pad_edge=False, header_style="bold")
    for heading in ("what it breaks", "file", "caught by"):
        made.add_column(heading, overflow="fold")
    made.add_column("s", justify="right")
    for outcome in outcomes:
        change = outcome.change
        made.add_row(change.breaks, change.file, outcome.word.rpartition("/")[2], f"{outcome.seconds:.1f}")
    return made


if __name__ == "__main__":
    sys.exit(main())
