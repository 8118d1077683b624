"""Achieved fitness of one study by two versions of this library: ``python -m tests.benchmarks.two_versions OLD NEW``.

    sysid-evo study docs/results/studies/search.toml --out build/old    # with the old version
    sysid-evo study docs/results/studies/search.toml --out build/new    # with the new one
    python -m tests.benchmarks.two_versions build/old build/new

Prints, for every controller, both means, the difference (new minus old, paired by robot and seed) with its 95 %
interval over robots and seeds, and the number of pairs in which the new version is better.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import pandas as pd
from rich.console import Console
from rich.table import Table

from evaluation.study.figures import Spread, differences

TOGETHER = "all controllers"


def achieved(folder: Path) -> dict[str, dict[tuple[str, str], float]]:
    """Return the fitness on the robot by controller, and by robot and seed."""
    rows = pd.read_parquet(folder / "controllers.parquet")
    tables = {str(name): part for name, part in rows.groupby("controller")} | {TOGETHER: rows}
    return {
        name: {
            (str(robot), str(seed)): float(value)
            for (robot, seed), value in part.groupby(["axis_robot", "axis_seed"]).achieved.mean().items()
        }
        for name, part in tables.items()
    }


def compared(old: Path, new: Path) -> Table:
    """Return a row for each controller that both studies have."""
    table = Table("controller", "old", "new", "new - old", "95 % interval", "better in", box=None)
    before, after = achieved(old), achieved(new)
    for name in [name for name in before if name in after]:
        pairs = differences(after[name], before[name])
        spread = Spread.of(pairs)
        if spread is None:
            continue
        interval = "" if spread.low is None else f"{spread.low:+.2f} to {spread.high:+.2f}"
        means = [sum(one[name][key] for key in pairs) / len(pairs) for one in (before, after)]
        better = f"{sum(value > 0 for value in pairs.values())} of {len(pairs)}"
        table.add_row(name, *(f"{mean:.2f}" for mean in means), f"{spread.mean:+.2f}", interval, better)
    return table


def main(arguments: list[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("old", type=Path)
    parser.add_argument("new", type=Path)
    given = parser.parse_args(arguments)
    Console().print(compared(given.old, given.new))
    return 0


if __name__ == "__main__":
    sys.exit(main())
