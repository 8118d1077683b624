"""Ideal time of a finished run on N processes: ``python -m tests.benchmarks.scaling RUN [--processes 1 2 1000]``.

The input is the records of the run, ``cells/*.json``: needs, seconds and files of each cell. Cells are scheduled as in
`sysid_evo.plan`, critical path first, on N processes that do nothing else: the ideal time of this plan. A measured run
takes longer because of process starts, the making of plan and report (``--around`` adds them), and shared memory and
caches.

``--copies 1 200`` simulates these numbers of independent runs, like the points of a study. ``--client 0.001`` simulates
one process that distributes all cells one after the other, with this number of seconds each. ``RUN`` may be a store of
several comparisons, whose shared cells count once; ``--point 3`` selects the third of them. The other tables are of one
copy: the cells by kind, those that take longest, and fit, evolution and trials of each family (medians).
"""

from __future__ import annotations

import argparse
import heapq
import sys
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.box import MARKDOWN
from rich.console import Console
from rich.table import Table

from sysid_evo.plan.store import CellRecord, Store
from tests.benchmarks.markdown import add_markdown, print_tables

END, ASIDE, RUN = "advise", "exploit", "run"
"""The kinds of the last cells of a comparison; of the same one the second needs nothing that the first does not.
And that of the trials of one controller on one system.
"""
TABLES = ("kinds", "longest", "families", "times")
LONGEST = 8
"""Titles that are shown of all that have seconds of their own."""


@dataclass(frozen=True)
class Recorded:
    """A cell of the records: ``needs`` holds the digests of needed cells, ``seconds`` is the time on one processor."""

    digest: str
    kind: str
    title: str
    needs: tuple[str, ...]
    seconds: float
    size: int
    files: int


def recorded(run: Path) -> list[Recorded]:
    """Return the cells of a run, each after those it needs. Raises ValueError if there are none."""
    records = {record.digest: record for record in Store(run).records()}
    if not records:
        raise ValueError(f"{run}: expected a run folder with records in {run / 'cells'}, found none")
    placed: dict[str, Recorded] = {}

    def place(record: CellRecord) -> None:
        if record.digest in placed:
            return
        needs = tuple(dict.fromkeys(digest for digest in record.needs if digest in records))
        for digest in needs:
            place(records[digest])
        sizes = [(run / name).stat().st_size for name in record.files if (run / name).is_file()]
        placed[record.digest] = Recorded(
            record.digest, record.kind, record.title, needs, record.seconds, sum(sizes), len(sizes)
        )

    for record in records.values():
        place(record)
    return list(placed.values())


def point(cells: Sequence[Recorded], number: int) -> list[Recorded]:
    """Return the cells of one of several comparisons, the ``number``-th from 1: what its last work needs, and that.

    Raises ValueError if there are fewer.
    """
    ends = [cell for cell in cells if cell.kind == END]
    if not 1 <= number <= len(ends):
        raise ValueError(f"expected the number of one of {len(ends)} finished comparisons, from 1, got {number}")
    wanted = {ends[number - 1].digest}
    for cell in reversed(cells):
        if cell.digest in wanted:
            wanted.update(cell.needs)
    wanted |= {cell.digest for cell in cells if cell.kind == ASIDE and wanted.issuperset(cell.needs)}
    return [cell for cell in cells if cell.digest in wanted]


def copied(cells: Sequence[Recorded], copies: int) -> list[Recorded]:
    """Return ``copies`` of the cells, which do not depend on each other."""
    return [
        Recorded(f"{i}/{c.digest}", c.kind, c.title, tuple(f"{i}/{n}" for n in c.needs), c.seconds, c.size, c.files)
        for i in range(copies)
        for c in cells
    ]


def work_ahead(cells: Sequence[Recorded]) -> dict[str, float]:
    """Return, by digest, the seconds from the start of a cell to the end of the longest chain of dependent cells."""
    by_digest = {cell.digest: cell for cell in cells}
    ahead = {cell.digest: cell.seconds for cell in cells}
    for cell in reversed(cells):
        for needed in cell.needs:
            ahead[needed] = max(ahead[needed], by_digest[needed].seconds + ahead[cell.digest])
    return ahead


def critical_path(cells: Sequence[Recorded]) -> list[Recorded]:
    """Return the longest chain of dependent cells, a lower bound of the time for any number of processes."""
    ahead = work_ahead(cells)
    path: list[Recorded] = []
    candidates = list(cells)
    while candidates:
        path.append(max(candidates, key=lambda cell: ahead[cell.digest]))
        candidates = [cell for cell in cells if path[-1].digest in cell.needs]
    return path


def makespan(cells: Sequence[Recorded], processes: int, client: float = 0.0) -> float:
    """Return the seconds until all cells are done on ``processes`` processes.

    An idle process gets the ready cell with the longest critical path. ``client`` is the time in s to distribute one
    cell; cells are distributed one at a time.
    """
    ahead = work_ahead(cells)
    by_digest = {cell.digest: cell for cell in cells}
    waiting = {cell.digest: len(cell.needs) for cell in cells}
    heirs: dict[str, list[str]] = defaultdict(list)
    for cell in cells:
        for needed in cell.needs:
            heirs[needed].append(cell.digest)
    ready = [(-ahead[digest], digest) for digest, count in waiting.items() if not count]
    heapq.heapify(ready)
    running: list[tuple[float, str]] = []
    now = free = 0.0
    while ready or running:
        while ready and len(running) < processes:
            _, digest = heapq.heappop(ready)
            free = max(now, free) + client
            heapq.heappush(running, (free + by_digest[digest].seconds, digest))
        now, digest = heapq.heappop(running)
        for heir in heirs[digest]:
            waiting[heir] -= 1
            if not waiting[heir]:
                heapq.heappush(ready, (-ahead[heir], heir))
    return now


def kinds(cells: Sequence[Recorded]) -> Table:
    """Return the cells by kind: number, seconds, bytes read and bytes written."""
    sizes = {cell.digest: cell.size for cell in cells}
    groups: dict[str, list[Recorded]] = defaultdict(list)
    for cell in cells:
        groups[cell.kind].append(cell)
    total = sum(cell.seconds for cell in cells)
    table = _table(
        "kind", "cells", "seconds", "share %", "s a cell", "longest s", "reads kB a cell", "writes kB a cell"
    )
    for kind, group in sorted(groups.items(), key=lambda item: -sum(cell.seconds for cell in item[1])):
        seconds = [cell.seconds for cell in group]
        read = sum(sizes[needed] for cell in group for needed in cell.needs)
        table.add_row(
            kind,
            str(len(group)),
            f"{sum(seconds):.1f}",
            f"{100 * sum(seconds) / total:.1f}",
            f"{sum(seconds) / len(group):.3f}",
            f"{max(seconds):.1f}",
            f"{read / len(group) / 1e3:.0f}",
            f"{sum(cell.size for cell in group) / len(group) / 1e3:.0f}",
        )
    return table


def longest(cells: Sequence[Recorded]) -> Table:
    """Return the median seconds of the work that has most of them, by its title."""
    groups: dict[str, list[float]] = defaultdict(list)
    for cell in cells:
        groups[cell.title].append(cell.seconds)
    middle = {title: sorted(seconds)[len(seconds) // 2] for title, seconds in groups.items()}
    table = _table("work", "cells", "median s")
    for title in sorted(groups, key=lambda title: -middle[title])[:LONGEST]:
        table.add_row(title, str(len(groups[title])), f"{middle[title]:.1f}")
    return table


def families(cells: Sequence[Recorded], steps: float | None) -> Table:
    """Return the median seconds of a fit, an evolution in the model, and the trials of one controller, by family.

    ``steps`` is the number of steps of one evolution, for its speed.
    """
    groups: dict[str, list[float]] = defaultdict(list)
    for cell in cells:
        groups[cell.title.rpartition(" on ")[2] if cell.kind == RUN else cell.title].append(cell.seconds)
    middle = {title: sorted(seconds)[len(seconds) // 2] for title, seconds in groups.items()}
    names = [title.removeprefix("evolve ") for title in middle if title.startswith("evolve ") and "+" not in title]
    table = _table("family", "fit, s", "evolution in it, s", "million steps a second", "trials of one controller, s")
    for name in sorted(names, key=lambda name: middle[f"evolve {name}"]):
        fit, evolution = middle.get(f"fit {name}"), middle[f"evolve {name}"]
        table.add_row(
            f"`{name}`",
            "" if fit is None else f"{fit:.1f}",
            f"{evolution:.1f}",
            "" if steps is None else f"{steps / evolution / 1e6:.0f}",
            f"{middle[name]:.3f}" if name in middle else "",
        )
    return table


def times(one: Sequence[Recorded], given: argparse.Namespace) -> Table:
    """Return the predicted seconds for each number of copies, each client, and each number of processes."""
    table = _table("copies", "client, s a cell", "processes", "predicted s", "processors at work %")
    for copies in given.copies:
        cells = copied(one, copies)
        total = sum(cell.seconds for cell in cells)
        for client in given.client:
            for count in given.processes:
                taken = given.around + makespan(cells, count, client)
                busy = 100 * total / (count * taken)
                table.add_row(str(copies), f"{client:g}", str(count), f"{taken:.0f}", f"{busy:.0f}")
    return table


def _table(*headings: str) -> Table:
    table = Table(box=MARKDOWN)
    for i, heading in enumerate(headings):
        table.add_column(heading, justify="right" if i else "left", no_wrap=True)
    return table


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the tables of a run, and return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.scaling", description=__doc__)
    parser.add_argument("run", type=Path, help="folder of a finished run, or a store of several")
    parser.add_argument("--processes", type=int, nargs="+", default=[1, 2, 4, 8, 16])
    parser.add_argument("--copies", type=int, nargs="+", default=[1], help="independent runs like this one (1)")
    parser.add_argument("--client", type=float, nargs="+", default=[0.0], help="seconds to hand out one cell (0)")
    parser.add_argument("--around", type=float, default=0.0, help="seconds before the first and after the last (0)")
    parser.add_argument("--point", type=int, help="take one of several comparisons in a store, from 1")
    parser.add_argument("--steps", type=float, help="steps of one evolution, for its speed")
    parser.add_argument("--tables", nargs="+", choices=TABLES, default=TABLES, help="only these")
    add_markdown(parser)
    given = parser.parse_args(arguments)
    try:
        one = recorded(given.run)
        one = one if given.point is None else point(one, given.point)
    except ValueError as error:
        parser.error(str(error))
    made = {
        "kinds": lambda: kinds(one),
        "longest": lambda: longest(one),
        "families": lambda: families(one, given.steps),
        "times": lambda: times(one, given),
    }
    out = Console(highlight=False, width=120)
    print_tables([made[name]() for name in given.tables], given.markdown, out)
    path = critical_path(one)
    out.print(
        f"{len(one)} cells, {sum(cell.seconds for cell in one):.0f} s of one processor, {_bytes(one)}; "
        f"the longest chain takes {sum(cell.seconds for cell in path):.1f} s: "
        + ", ".join(f"{cell.title} {cell.seconds:.1f}" for cell in path)
        + ".",
        soft_wrap=True,
    )
    return 0


def _bytes(cells: Sequence[Recorded]) -> str:
    files = sum(cell.files + 2 for cell in cells)  # and each has a record and a lock
    return f"{sum(cell.size for cell in cells) / 1e6:.0f} MB of results in {files} files"


if __name__ == "__main__":
    sys.exit(main())
