"""Fitness of the recommended controller of a comparison at each task: ``python -m tests.benchmarks.tasks --out DIR``.

Each of ``--cases`` is a robot and a task. A comparison with default settings records the emulated robot, evolves
controllers in the models, and one controller on the robot itself by one search. Prints the achieved fitness of the
recommended controller and of the one evolved on the robot, and the total processor time. Each case and seed has its own
folder, in which finished steps are not repeated.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from rich.console import Console
from rich.table import Table

from evaluation import ComparisonResults, compare
from tests.benchmarks.markdown import add_markdown, print_tables

CASES = "pendulum/swing_up,cart_pole/balance,thermal/set_point"
COLUMNS = ("robot", "task", "seed", "recommended", "achieved", "search on the robot", "processor time, s")
WORDS = 4


def row_of(report: ComparisonResults, robot: str, task: str, seed: int, seconds: float) -> tuple[str, ...]:
    """Return one row of the table; achieved by both are means over trials, ± standard errors."""
    assert report.transfer is not None
    controllers = report.transfer.controllers
    pick = next(c for c in controllers if c.name == report.transfer.pick)
    reference = next(c for c in controllers if c.evolved_on_robot)
    assert pick.achieved is not None
    assert reference.achieved is not None
    shown = (f"{value.value:.1f} ± {value.standard_error:.1f}" for value in (pick.achieved, reference.achieved))
    return (
        robot,
        task,
        str(seed),
        f"{pick.name} of {', '.join(pick.against)}",
        *shown,
        f"{seconds:.0f}",
    )


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark from the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--cases", default=CASES)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1])
    parser.add_argument("--minutes", type=float, default=6.0)
    parser.add_argument("--generations", type=int, help="of each evolution (default: the preset's)")
    add_markdown(parser)
    options = parser.parse_args(arguments)
    console, table = Console(), Table(title="evolved on models only, and on the emulated robot itself")
    for number, heading in enumerate(COLUMNS):
        table.add_column(heading, justify="right" if number >= WORDS else "left")
    for case in options.cases.split(","):
        robot, task = case.split("/")
        for seed in options.seeds:
            began = time.process_time()
            report = compare(
                out=options.out / f"{robot}-{task}-{seed}",
                robot=robot,
                task=task,
                seed=seed,
                minutes=options.minutes,
                generations=options.generations,
                reference=True,
            )
            row = row_of(report, robot, task, seed, time.process_time() - began)
            console.print(*row)
            table.add_row(*row)
    print_tables([table], options.markdown, console)
    return 0


if __name__ == "__main__":
    sys.exit(main())
