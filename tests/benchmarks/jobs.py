"""A comparison with one job, with several jobs, and on Dask: ``python -m tests.benchmarks.jobs [--preset quick]``.

Measures wall time and processor time of the whole command with all its processes, ``--repeats`` times in turn, each in
a new folder; the minimum counts. ``--jobs 1 2`` are the numbers of processes, ``--workers 2`` those of a local Dask
cluster that is already running. ``again`` is a second run of the same command in the same folder. Other
work on the machine increases the wall time, and the processor time a little. ``report.json`` must be the same for any
number of jobs, except ``timings``: exit code 1 if it is not. Options after ``--`` are passed to ``compare``.

Also prints the inputs of a cost model: seconds and bytes of each kind of cell, the amount of data sent to the workers,
and the cost of distributing a cell, measured on ``--cells`` empty cells: processor time of all local processes, and
wall time on a cluster.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from sysid_evo.plan import Store, execute
from sysid_evo.processors import usable_processors
from tests.benchmarks.markdown import add_markdown, print_tables
from tests.fixtures.dask_cluster import Processes
from tests.fixtures.deeds import planned

ROOT = Path(__file__).parents[2]


@dataclass
class Row:
    """One way to run the command: options, and times in s."""

    name: str
    options: tuple[str, ...]
    workers: int = 0
    wall: list[float] = field(default_factory=list)
    processor: list[float] = field(default_factory=list)
    again: list[float] = field(default_factory=list)
    report: dict[str, Any] | None = None
    kinds: dict[str, Kind] = field(default_factory=dict)
    sent: int = 0

    def run(self) -> None:
        """Run the command in a fresh folder, and again. Raises `subprocess.CalledProcessError`."""
        with tempfile.TemporaryDirectory(prefix="sysid-evo-jobs-") as folder, dask(self.workers) as cluster:
            where = () if cluster is None else ("--scheduler", str(cluster.file))
            command = [sys.executable, "-m", "sysid_evo", "--quiet", "compare", "--out", folder, *self.options, *where]
            there = 0.0 if cluster is None else cluster.processor()
            wall, processor = self._timed(command)
            self.wall.append(wall)
            self.processor.append(processor + (0.0 if cluster is None else cluster.processor() - there))
            self.again.append(self._timed(command)[0])
            self.report = json.loads((Path(folder) / "report.json").read_text(encoding="utf-8"))
            del self.report["timings"]
            self.kinds, self.sent = sizes(Store(Path(folder)))

    def _timed(self, command: list[str]) -> tuple[float, float]:
        """Return wall time and processor time of a command, without those of a cluster."""
        began, before = time.perf_counter(), _processor()
        subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.DEVNULL, stderr=sys.stderr)
        return time.perf_counter() - began, _processor() - before


@dataclass
class Kind:
    """Cells of one kind: number, total and longest time in s, bytes of their results."""

    cells: int = 0
    seconds: float = 0.0
    longest: float = 0.0
    bytes: int = 0

    def add(self, seconds: float, size: int) -> None:
        """Count one more cell."""
        self.cells, self.seconds, self.bytes = self.cells + 1, self.seconds + seconds, self.bytes + size
        self.longest = max(self.longest, seconds)


@contextmanager
def dask(workers: int) -> Iterator[Processes | None]:
    """Run a local cluster of ``workers`` workers; none for 0."""
    if not workers:
        yield None
        return
    with tempfile.TemporaryDirectory(prefix="sysid-evo-dask-") as folder:
        cluster = Processes(Path(folder))
        cluster.start(workers)
        try:
            cluster.wait()
            yield cluster
        finally:
            cluster.stop()


def sizes(store: Store) -> tuple[dict[str, Kind], int]:
    """Return the finished cells of a run by their kind, and the bytes of all results that another cell needs."""
    kinds: dict[str, Kind] = {}
    records = {record.digest: record for record in store.records() if record.status == "done"}
    size = {digest: sum(len(content) for _, _, content in store.bundle(digest)) for digest in records}
    for digest, record in records.items():
        kinds.setdefault(record.kind, Kind()).add(record.seconds, size[digest])
    needed = {digest for record in records.values() for digest in record.needs}
    return kinds, sum(size[digest] for digest in needed & set(records))


SHORT = """
import sys
from pathlib import Path
from sysid_evo.plan import Store, execute
from tests.fixtures.deeds import planned
folder, cells = Path(sys.argv[1]), [(str(i), "", []) for i in range(int(sys.argv[3]))]
execute(planned(folder / "diary", *cells), Store(folder), jobs=int(sys.argv[2]))
"""


def short_cells(jobs: int, cells: int) -> float:
    """Return the processor time in s of ``cells`` empty cells with this number of jobs, including process starts."""
    with tempfile.TemporaryDirectory(prefix="sysid-evo-cells-") as folder:
        before = _processor()
        command = [sys.executable, "-c", SHORT, folder, str(jobs), str(cells)]
        subprocess.run(command, cwd=ROOT, check=True)
        return _processor() - before


def overhead(workers: int, cells: int) -> float:
    """Return the seconds that a cluster of ``workers`` takes for a cell that does nothing, when all is warm."""
    with tempfile.TemporaryDirectory(prefix="sysid-evo-cells-") as folder, dask(workers) as cluster:
        assert cluster is not None
        plan = planned(Path(folder) / "diary", *((str(i), "", []) for i in range(cells)))
        taken = []
        for name in ("cold", "warm"):
            began = time.perf_counter()
            execute(plan, Store(Path(folder) / name), scheduler=cluster.file)
            taken.append((time.perf_counter() - began) / cells)
    return taken[-1]


def _processor() -> float:
    """Return the processor time of all processes that were started here and have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def measured(options: Sequence[str], jobs: Sequence[int], workers: Sequence[int], repeats: int) -> list[Row]:
    """Return the rows, each run ``repeats`` times in turn."""
    rows = [Row(f"{count} jobs" if count > 1 else "1 job", (*options, "--jobs", str(count))) for count in jobs]
    rows += [Row(f"Dask, {count} worker{'s' if count > 1 else ''}", tuple(options), count) for count in workers]
    for _ in range(repeats):
        for row in rows:
            row.run()
    return rows


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print tables, and return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.jobs", description=__doc__)
    parser.add_argument("--preset", default="quick", help="of the comparison (quick)")
    parser.add_argument("--jobs", type=int, nargs="*", default=[1, usable_processors()])
    parser.add_argument("--workers", type=int, nargs="*", default=[2], help="of local Dask clusters (2)")
    parser.add_argument("--cells", type=int, default=200, help="that do nothing (200); 0 leaves them out")
    parser.add_argument("--repeats", type=int, default=1)
    add_markdown(parser)
    parser.add_argument("further", nargs="*", help="options of compare")
    given = parser.parse_args(arguments)
    rows = measured(["--preset", given.preset, *given.further], given.jobs, given.workers, given.repeats)
    out = Console(highlight=False)
    print_tables([times(rows)], given.markdown, out)
    out.print(costs(rows[-1]))
    out.print(f"Results that other cells need, each sent to the workers once: {rows[-1].sent / 1e6:.2f} MB.")
    taken = {count: short_cells(count, given.cells) for count in given.jobs if given.cells}
    text = ", ".join(f"{count} jobs {seconds:.1f} s" for count, seconds in taken.items())
    out.print(f"{given.cells} cells that do nothing take, in processor time: {text}.")
    if given.cells and given.workers:
        seconds = overhead(given.workers[-1], given.cells)
        out.print(f"A cell that does nothing takes {1e3 * seconds:.1f} ms on {given.workers[-1]} workers.")
    same = all(row.report == rows[0].report for row in rows)
    out.print(f"report.json is {'the same' if same else 'NOT the same'} for any number of jobs, apart from timings.")
    out.print(f"Load average {os.getloadavg()[0]:.1f} on {usable_processors()} processors.")
    return 0 if same else 1


def times(rows: Sequence[Row]) -> Table:
    """Return the times of all rows."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    for heading in ("run", "wall s", "processor s", "wall, first / this", "processor, first / this", "again, s"):
        table.add_column(heading, justify="left" if heading == "run" else "right")
    first = rows[0]
    for row in rows:
        ratios = (min(first.wall) / min(row.wall), min(first.processor) / min(row.processor))
        least = (f"{min(row.wall):.1f}", f"{min(row.processor):.1f}")
        table.add_row(row.name, *least, *(f"{ratio:.2f}" for ratio in ratios), f"{min(row.again):.1f}")
    return table


def costs(row: Row) -> Table:
    """Return the time and the size of the results of each kind of cell."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    for heading in (f"cells, {row.name}", "number", "s in all", "s each", "s at most", "kB each"):
        table.add_column(heading, justify="left" if heading.startswith("cells") else "right")
    for name, kind in sorted(row.kinds.items(), key=lambda item: -item[1].seconds):
        each = (f"{kind.seconds / kind.cells:.2f}", f"{kind.longest:.2f}", f"{kind.bytes / kind.cells / 1e3:.1f}")
        table.add_row(name, str(kind.cells), f"{kind.seconds:.1f}", *each)
    return table


if __name__ == "__main__":
    sys.exit(main())
