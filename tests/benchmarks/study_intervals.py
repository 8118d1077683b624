"""Coverage of the intervals of a study on simulated numbers: ``python -m tests.benchmarks.study_intervals``.

A number of a robot and a seed is normal: the truth 0, plus a deviation of the robot, plus one of the seed with standard
deviation 1. Prints how often the 95 % interval of `evaluation.study.figures.Spread` contains the truth, and in brackets
its mean width. With one robot the truth is that robot's mean.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np
from rich.table import Table

from evaluation.study.figures import Spread
from tests.benchmarks.markdown import add_markdown, print_tables

CASES = ((3, 3), (3, 5), (5, 5), (8, 5), (1, 5), (1, 10))
DEVIATIONS = {"robots do not differ": 0.0, "differ as much as seeds": 1.0, "three times as much": 3.0}


def coverage(robots: int, seeds: int, deviation: float, draws: int) -> tuple[float, float]:
    """Return the share of intervals that contain the truth, and their mean width."""
    rng = np.random.default_rng([robots, seeds, round(10 * deviation)])
    inside, widths = 0, []
    for _ in range(draws):
        values = deviation * rng.standard_normal((robots, 1)) + rng.standard_normal((robots, seeds))
        spread = Spread.of({(str(i), str(k)): float(value) for (i, k), value in np.ndenumerate(values)})
        assert spread is not None
        assert spread.low is not None
        assert spread.high is not None
        inside += spread.low <= 0.0 <= spread.high
        widths.append(spread.high - spread.low)
    return inside / draws, float(np.mean(widths))


def main(arguments: list[str] | None = None) -> int:
    """Draw, and print the table."""
    parser = argparse.ArgumentParser(prog="tests.benchmarks.study_intervals", description=__doc__)
    parser.add_argument("--draws", type=int, default=4000)
    add_markdown(parser)
    given = parser.parse_args(arguments)
    table = Table("robots, seeds", *DEVIATIONS)
    for robots, seeds in CASES:
        row = []
        for deviation in DEVIATIONS.values():
            if robots > 1 or deviation == 0.0:
                share, width = coverage(robots, seeds, deviation, given.draws)
                row.append(f"{100 * share:.0f} % ({width:.1f})")
        table.add_row(f"{robots}, {seeds}", *row)
    print_tables([table], given.markdown)
    return 0


if __name__ == "__main__":
    sys.exit(main())
