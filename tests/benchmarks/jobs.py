"""A comparison with one job and with several: ``python -m tests.benchmarks.jobs [--preset quick] [--jobs 1 2]``.

Wall time and processor time of the whole command, of all its processes, from its start to the report, ``--repeats``
times in turn, each in a fresh folder; the least of each counts. ``--before FOLDER`` is a checkout of an earlier state
that is measured beside it, with the options it has. Other work on the machine lengthens the wall time, and the
processor time a little. ``report.json`` must be the same for any number of jobs, apart from ``timings``: exits 1 if
it is not. Further options, behind ``--``, are handed to ``compare``.
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
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from sysid_evo.processors import usable_processors

ROOT = Path(__file__).parents[2]


@dataclass
class Row:
    """One way to run the command: where, with which options, and what it took, in s."""

    name: str
    checkout: Path
    options: tuple[str, ...]
    wall: list[float] = field(default_factory=list)
    processor: list[float] = field(default_factory=list)
    report: dict[str, Any] | None = None

    def run(self) -> None:
        """Run the command once in a fresh folder. Raises `subprocess.CalledProcessError`."""
        with tempfile.TemporaryDirectory(prefix="sysid-evo-jobs-") as folder:
            command = [sys.executable, "-m", "sysid_evo", "--quiet", "compare", "--out", folder, *self.options]
            environment = {**os.environ, "PYTHONPATH": str(self.checkout)}
            began, before = time.perf_counter(), _processor()
            subprocess.run(
                command, cwd=self.checkout, env=environment, check=True, stdout=subprocess.DEVNULL, stderr=sys.stderr
            )
            self.wall.append(time.perf_counter() - began)
            self.processor.append(_processor() - before)
            self.report = json.loads((Path(folder) / "report.json").read_text(encoding="utf-8"))
            del self.report["timings"]


def _processor() -> float:
    """Return the processor time of all processes that were started here and have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def measured(options: Sequence[str], jobs: Sequence[int], before: Path | None, repeats: int) -> list[Row]:
    """Return the rows, the earlier state first, each run ``repeats`` times in turn."""
    rows = [Row(f"{count} jobs" if count > 1 else "1 job", ROOT, (*options, "--jobs", str(count))) for count in jobs]
    if before is not None:
        rows.insert(0, Row("before", before.resolve(), tuple(options)))
    for _ in range(repeats):
        for row in rows:
            row.run()
    return rows


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print a table, and return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.jobs", description=__doc__)
    parser.add_argument("--preset", default="quick", help="of the comparison (quick)")
    parser.add_argument("--jobs", type=int, nargs="+", default=[1, usable_processors()])
    parser.add_argument("--before", type=Path, help="checkout of an earlier state")
    parser.add_argument("--repeats", type=int, default=1)
    parser.add_argument("further", nargs="*", help="options of compare")
    given = parser.parse_args(arguments)
    rows = measured(["--preset", given.preset, *given.further], given.jobs, given.before, given.repeats)
    table = Table(box=None, pad_edge=False, header_style="bold")
    for heading in ("", "wall s", "processor s", "wall, first / this", "processor, first / this"):
        table.add_column(heading, justify="right" if heading else "left")
    first = rows[0]
    for row in rows:
        ratios = (min(first.wall) / min(row.wall), min(first.processor) / min(row.processor))
        table.add_row(row.name, f"{min(row.wall):.1f}", f"{min(row.processor):.1f}", *(f"{r:.2f}" for r in ratios))
    out = Console(highlight=False)
    out.print(table)
    ours = [row for row in rows if row.checkout == ROOT]
    same = all(row.report == ours[0].report for row in ours)
    out.print(f"report.json is {'the same' if same else 'NOT the same'} for any number of jobs, apart from timings.")
    out.print(f"Load average {os.getloadavg()[0]:.1f} on {usable_processors()} processors.")
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(main())
