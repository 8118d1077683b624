"""What controllers that were evolved on models achieve on the walled track: ``python -m tests.benchmarks.walled``.

For each seed an emulated car is recorded and compared by the defaults of `sysid-evo compare --task walled_track
--yardstick` in ``--out`` (what stands there is not done again). Prints what the recommended controller, which met
models only, claims and achieves on the car in 100 fresh trials, what a controller evolved on the car itself achieves,
and the share of the one in the other; at last the processor seconds of what was computed now.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from evaluation import compare
from evaluation.transfer import TransferMatrix

ROBOT, RECOMMENDED = "emulated_car", "recommended"


def row(matrix: TransferMatrix, robot: str) -> tuple[float, float, float]:
    """Return what the recommended controller claims and achieves on ``robot``, and the yardstick, in m."""
    own = next(champion for champion in matrix.champions if champion.name == RECOMMENDED)
    claimed = min(matrix.cell(RECOMMENDED, model).mean for model in own.against)
    return claimed, matrix.cell(RECOMMENDED, robot).mean, matrix.cell(robot, robot).mean


def main(arguments: list[str] | None = None) -> int:
    """Make the comparisons that are missing and print the table."""
    parser = argparse.ArgumentParser(prog="tests.benchmarks.walled", description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--task", default="walled_track")
    parser.add_argument("--models", help="families, separated by commas (default: those of compare)")
    parser.add_argument("--minutes", type=float, default=6.0)
    parser.add_argument("--generations", type=int)
    given = parser.parse_args(arguments)
    table = Table(title=f"{given.task} on the {ROBOT}, m")
    for heading in ("seed", "claimed", "achieved", "yardstick", "share", "processor s"):
        table.add_column(heading, justify="right")
    shares = []
    for seed in range(given.seeds):
        began = time.process_time()
        report = compare(
            out=given.out / f"seed-{seed}",
            robot=ROBOT,
            task=given.task,
            minutes=given.minutes,
            models=tuple(given.models.split(",")) if given.models else None,
            ensembles=(),
            generations=given.generations,
            yardstick=True,
            seed=seed,
        )
        assert report.matrix is not None
        claimed, achieved, yardstick = row(report.matrix, ROBOT)
        shares.append(achieved / yardstick)
        spent = time.process_time() - began
        table.add_row(str(seed), *(f"{value:.1f}" for value in (claimed, achieved, yardstick)),
                      f"{shares[-1]:.2f}", f"{spent:.0f}")  # fmt: skip
    table.add_row("mean", "", "", "", f"{np.mean(shares):.2f}", "")
    Console(width=100).print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
