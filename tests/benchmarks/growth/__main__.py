"""Growth of cost and memory with size: ``python -m tests.benchmarks.growth [--parts commands,fits] [--out FOLDER]``.

Each operation is run at increasing sizes; its processor time is the minimum of several rounds over all sizes. The slope
on log axes over the upper part of the range (sizes from a tenth of the largest) measures the growth: 1 is linear.
Prints a table and writes ``growth.json`` to ``--out``. A slope that is worse than possible is marked with an
exclamation mark.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from tests.benchmarks.growth.cases import PARTS, cases
from tests.benchmarks.growth.measuring import WORSE, Curve, measured
from tests.benchmarks.markdown import add_markdown, print_tables

MOST_SECONDS = 6.0


def table(curves: Sequence[Curve]) -> Table:
    """Return one row for each curve: its range, cost and memory at the largest size, and both slopes."""
    found = Table(title="processor time and memory at the largest size", title_justify="left")
    for name in ("what", "grows with", "up to", "s", "slope", "MB", "slope"):
        found.add_column(name, justify="left" if name in ("what", "grows with") else "right")
    for curve in curves:
        worse = curve.slope > max(curve.growth.best, 1.0) + WORSE - 1.0
        found.add_row(
            curve.growth.name,
            curve.growth.axis,
            f"{curve.sizes[-1]:,}",
            f"{curve.seconds[-1]:.3g}",
            f"{curve.slope:.2f}{' !' if worse else ''}",
            f"{curve.megabytes[-1]:.3g}" if curve.megabytes else "",
            f"{curve.memory_slope:.2f}" if curve.megabytes else "",
        )
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, print the table, write the figures."""
    parser = argparse.ArgumentParser(prog="tests.benchmarks.growth", description=__doc__)
    parser.add_argument("--parts", default=",".join(PARTS), help="of " + ", ".join(PARTS))
    parser.add_argument("--only", default="", help="only what has one of these, separated by commas, in its name")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument(
        "--most-seconds", type=float, default=MOST_SECONDS, help="of one run; larger sizes are left out"
    )
    parser.add_argument("--quick", action="store_true", help="two small sizes each: does it run?")
    parser.add_argument("--without-memory", action="store_true")
    parser.add_argument("--out", type=Path, help="folder for growth.json")
    add_markdown(parser)
    chosen = parser.parse_args(arguments)
    parts = chosen.parts.split(",")
    unknown = sorted(set(parts) - set(PARTS))
    if unknown:
        parser.error(f"--parts: expected some of {', '.join(PARTS)}, got {', '.join(unknown)}")
    console, curves, began = Console(width=110), [], time.perf_counter()
    with threadpool_limits(1):
        for growth in cases(chosen.quick):
            if growth.part not in parts or not any(word in growth.name for word in chosen.only.split(",")):
                continue
            curves.append(
                measured(
                    growth,
                    rounds=1 if chosen.quick else chosen.rounds,
                    most_seconds=chosen.most_seconds,
                    memory=not chosen.without_memory,
                )
            )
            last = curves[-1]
            console.print(
                f"{time.perf_counter() - began:6.0f} s  {growth.name}: {last.seconds[-1]:.3g} s of {last.sizes[-1]:,} "
                f"{growth.axis}, slope {last.slope:.2f}",
                highlight=False,
            )
            if chosen.out is not None:
                chosen.out.mkdir(parents=True, exist_ok=True)
                rows = [
                    {"part": c.growth.part, "name": c.growth.name, "axis": c.growth.axis, "sizes": c.sizes,
                     "seconds": c.seconds, "megabytes": c.megabytes, "slope": c.slope}
                    for c in curves
                ]  # fmt: skip
                (chosen.out / "growth.json").write_text(json.dumps(rows, indent=1))
    if not curves:
        parser.error(f"--only: nothing in {', '.join(parts)} has {chosen.only!r} in its name")
    print_tables([table(curves)], chosen.markdown, console)


if __name__ == "__main__":
    main()
