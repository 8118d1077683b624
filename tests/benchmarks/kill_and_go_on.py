"""A comparison that is killed goes on to the same report: ``python -m tests.benchmarks.kill_and_go_on [--times 10]``.

A small comparison is run to its end once. Then the same command is killed (SIGKILL) in a fresh folder at
``--times`` seeded random moments, going on in that folder each time, and is run to its end; then the same
with two processes at once in one folder, both killed. ``report.json`` must be the same apart from ``timings``.
Prints a table and exits 1 if anything differs.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sysid_evo.testing import example_dataset
from tests.sysid_evo.cli.calling import COMMAND

MODELS = "linear,nearest_neighbour,near2=nearest_neighbour(state_lags=2)"
EXPERIMENT = (
    *("--models", MODELS, "--ensembles", "linear+near2", "--robot", "emulated_car"),
    *("--generations", "30", "--trials", "4", "--runs", "1", "--task", "point_to_point(horizon=200)"),
)
LIMIT = 600.0  # s, for one command


@dataclass(frozen=True)
class Row:
    """What was done: processes at once, kills, cells that stood there after kills, and how it came out."""

    what: str
    kills: int
    kept: int
    seconds: float
    same: bool


def start(folder: Path, out: Path) -> subprocess.Popen[bytes]:
    """Start the comparison of the data in ``folder`` in the run folder ``out``."""
    arguments = ("compare", "--data", str(folder / "car"), *EXPERIMENT, "--out", str(out), "--quiet")
    return subprocess.Popen(
        [*COMMAND, *arguments], cwd=folder, env={**os.environ, "TERM": "dumb"}, stdout=subprocess.DEVNULL
    )


def finish(processes: list[subprocess.Popen[bytes]]) -> float:
    """Wait for all; return the seconds. Raises `RuntimeError` if one does not end with 0."""
    began = time.perf_counter()
    for process in processes:
        if process.wait(LIMIT) != 0:
            raise RuntimeError(f"the comparison ended with {process.returncode}")
    return time.perf_counter() - began


def kill_after(processes: list[subprocess.Popen[bytes]], seconds: float) -> int:
    """Kill all after ``seconds``; return how many were still at work."""
    time.sleep(seconds)
    running = sum(process.poll() is None for process in processes)
    for process in processes:
        process.kill()
        process.wait(LIMIT)
    return running


def report_of(out: Path) -> dict[str, Any]:
    """Return the report of a run apart from its timings."""
    found: dict[str, Any] = json.loads((out / "report.json").read_text())
    del found["timings"]
    return found


def rows(folder: Path, times: int, seed: int) -> list[Row]:
    """Run everything in ``folder`` and return the table."""
    example_dataset().save(folder / "car")
    finish([start(folder, folder / "warm")])  # compiled kernels are on disk from here on
    whole = finish([start(folder, folder / "whole")])
    expected = report_of(folder / "whole")
    found = [Row("to the end at once", 0, 0, whole, expected == report_of(folder / "warm"))]
    rng = np.random.default_rng(seed)
    for together in (1, 2):
        what = "one process" if together == 1 else f"{together} processes at once"
        found.append(killed(folder, what, together, times, rng, whole, expected))
    return found


def killed(
    folder: Path, what: str, together: int, times: int, rng: np.random.Generator, whole: float, expected: dict[str, Any]
) -> Row:
    """Kill and go on ``times``; where the end comes before the kill, the next one strikes in a fresh folder."""
    kills, kept, ends = 0, 0, 0
    same, began = True, time.perf_counter()
    while kills < times:
        out = folder / f"killed-{together}-{ends}"
        if kill_after([start(folder, out) for _ in range(together)], float(rng.uniform(0.2, 1.0)) * whole):
            kills += 1
            kept += len(list((out / "cells").glob("*.json")))
        else:
            same, ends = same and report_of(out) == expected, ends + 1
    out = folder / f"killed-{together}-{ends}"
    finish([start(folder, out) for _ in range(together)])
    return Row(what, kills, kept, time.perf_counter() - began, same and report_of(out) == expected)


def main() -> int:
    """Print the table; return 1 if a report differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=10, help="kills of one, and of two processes at once (10)")
    parser.add_argument("--seed", type=int, default=0, help="of the moments (0)")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        table = rows(Path(folder), arguments.times, arguments.seed)
    write = sys.stdout.write
    write(f"{'run':24} {'kills':>5} {'cells kept':>10} {'s':>6}   report\n")
    for row in table:
        same = "the same" if row.same else "DIFFERS"
        write(f"{row.what:24} {row.kills:5d} {row.kept:10d} {row.seconds:6.1f}   {same}\n")
    return int(not all(row.same for row in table))


if __name__ == "__main__":
    sys.exit(main())
