"""The choice against hindsight: ``python -m tests.benchmarks.hindsight --out FOLDER [--seeds 0,1] [--minutes 3]``.

The awkward car is recorded while it is blocked in the share ``--stuck`` of the manoeuvres. A comparison by default
settings (but ``--generations``) chooses a controller. Another one from the same recording has the families that are not
among the default ones. *Possible* is the best controller that any family gave, by its mean fitness on the robot in
fresh trials. Prints what was left out of the recording, the chosen controller, and the share of the possible.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from rich.table import Table

from evaluation.results import ComparisonResults
from evaluation.running import FURTHER_FAMILIES, compare
from tests.benchmarks.markdown import add_markdown, print_tables

NOT_A_FAMILY = "auto"


def achieved(report: ComparisonResults) -> dict[str, float]:
    """Return the mean fitness on the robot of every controller that was evolved in models."""
    assert report.matrix is not None
    assert report.matrix.robot is not None
    evolved = [one.name for one in report.matrix.champions if one.against]
    return {name: report.matrix.cell(name, report.matrix.robot).mean for name in evolved}


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark from the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", default="0")
    parser.add_argument("--minutes", type=float, default=3.0)
    parser.add_argument("--stuck", type=float, default=0.5)
    parser.add_argument("--generations", type=int, default=60)
    add_markdown(parser)
    given = parser.parse_args(arguments)
    heads = "seed", "recorded and used, s", "tried", "chosen", "achieved", "possible", "by", "share"
    table = Table(*heads, title=f"awkward_car(stuck={given.stuck:g}), {given.minutes:g} min", box=None)
    for seed in map(int, given.seeds.split(",")):
        usual, more = (
            compare(
                out=given.out / f"{seed}-{name}", robot=f"awkward_car(stuck={given.stuck:g})", seed=seed,
                minutes=given.minutes, generations=given.generations, reference=False, jobs=1, **families,
            )
            for name, families in (
                ("default", {}),
                ("further", {"models": tuple(name for name in FURTHER_FAMILIES if name != NOT_A_FAMILY)}),
            )
        )  # fmt: skip
        both = {f"{name} (further)": mean for name, mean in achieved(more).items()} | achieved(usual)
        best = max(both, key=lambda name: both[name])
        assert usual.transfer is not None
        pick = usual.transfer.pick or "none"
        own = both.get(pick, float("nan"))
        used = sum(episode.duration for part in (usual.data.training, usual.data.test) for episode in part)
        tried = ", ".join(usual.settings.get("tried_models") or ()) or "none"
        cells = f"{60.0 * given.minutes:.0f}, {used:.0f}", tried, pick, f"{own:.2f}", f"{both[best]:.2f}", best
        table.add_row(str(seed), *cells, f"{own / both[best]:.2f}")
    print_tables([table], given.markdown)
    return 0


if __name__ == "__main__":
    sys.exit(main())
