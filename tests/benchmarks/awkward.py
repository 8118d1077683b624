"""Whether good driving is found on an awkward car: ``python -m tests.benchmarks.awkward --out FOLDER [--seeds 2]``.

The car starts late, has no reverse and is stuck in some recordings, so that more than half of the six minutes shows a
standing car (`hardware.emulation.awkward_car`). Some models then deny that it can race. For every seed a comparison is
made in ``FOLDER/seed-S`` (``sysid-evo compare --robot awkward_car --yardstick``): a controller for each quick family,
one by the recommended recipe, and one evolved on the car itself, by niches. What is possible is the best that any of
all seeds achieves, or ``--yardstick`` if that is higher. Prints what each claims and achieves, which models were not
believed, what `inspect` and `evolve` say to record, and the share of what is possible that the recipe achieves. Ends
with 1 where that is below 80 % and nothing is said to record.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

from evaluation import compare
from evaluation.comparison.champion_cells import RECOMMENDED
from evaluation.transfer import TransferMatrix
from sysid_evo.cli.columns import dynamics_of, find_column
from sysid_evo.cli.unrecorded import regions_of
from sysid_evo.data import Dataset, advise
from sysid_evo.plan import Store

ROBOT = "awkward_car"
FAMILIES = "parametrised,sindy,backprop27,hybrid_ode,nearest_neighbour,linear"
DEMANDED = 0.8
TRIALS = 300


@dataclass(frozen=True)
class Outcome:
    """What came out for one seed: waypoints of the recipe and of the best, models not believed, what to record."""

    seed: int
    achieved: float
    claimed: float
    best: float
    denying: tuple[str, ...]
    advice: tuple[str, ...]
    regions: tuple[str, ...]

    def enough(self, possible: float) -> bool:
        """Whether the demand is met: a good driver, or a word on what to record."""
        return self.achieved >= DEMANDED * possible or bool(self.advice or self.regions)


def outcome(matrix: TransferMatrix, folder: Path, seed: int) -> Outcome:
    """Return what the comparison in ``folder`` found."""
    assert matrix.robot is not None
    champion = next(one for one in matrix.champions if one.name == RECOMMENDED)
    store = Store(folder)
    models = {label: dynamics_of(store, find_column(store, label)) for label in matrix.models}
    training = next(Dataset.load(path) for path in sorted((folder / "data").glob("*/training")))
    achieved = {one.name: matrix.cell(one.name, matrix.robot).mean for one in matrix.champions}
    return Outcome(
        seed=seed,
        achieved=achieved[RECOMMENDED],
        claimed=min(matrix.cell(RECOMMENDED, column).mean for column in champion.against),
        best=max(achieved.values()),
        denying=tuple(label for label in matrix.models if label not in champion.against),
        advice=advise(training).suggestions,
        regions=tuple(region.sentence for region in regions_of(champion, models)),
    )


def table(matrix: TransferMatrix) -> Table:
    """Return claim and achievement of each controller, and its fitness on every model."""
    found = Table(title="waypoints: row: controller, column: where it drives")
    for number, name in enumerate(("controller", *matrix.columns)):
        found.add_column(name, justify="right" if number else "left", overflow="fold")
    for row in matrix.rows:
        found.add_row(row, *(f"{matrix.cell(row, column).mean:.1f}" for column in matrix.columns))
    return found


def main(arguments: list[str] | None = None) -> int:
    """Make the comparisons that are missing and print what they found."""
    parser = argparse.ArgumentParser(prog="tests.benchmarks.awkward", description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--minutes", type=float, default=6.0)
    parser.add_argument("--robot", default=ROBOT)
    parser.add_argument("--models", default=FAMILIES)
    parser.add_argument("--preset", default="quick")
    parser.add_argument("--yardstick", type=float, default=0.0, help="waypoints known to be possible")
    given = parser.parse_args(arguments)
    console, found = Console(width=110), []
    for seed in range(given.seeds):
        folder = given.out / f"seed-{seed}"
        report = compare(
            out=folder,
            robot=given.robot,
            minutes=given.minutes,
            models=tuple(given.models.split(",")),
            ensembles=(),
            preset=given.preset,
            transfer_trials=TRIALS,
            traces=0,
            yardstick=True,
            seed=seed,
        )
        assert report.matrix is not None
        one = outcome(report.matrix, folder, seed)
        found.append(one)
        console.print(table(report.matrix))
        console.print(f"said of the recording: {' '.join(one.advice) or 'nothing'}", highlight=False)
        console.print(f"to record next: {'; '.join(one.regions) or 'nothing'}", highlight=False)
    possible = max([given.yardstick, *(one.best for one in found)])
    for one in found:
        console.print(
            f"seed {one.seed}: the recipe claims {one.claimed:.1f} and achieves {one.achieved:.1f} of {possible:.1f} "
            f"waypoints, {100 * one.achieved / possible:.0f} %; not believed: {', '.join(one.denying) or 'none'}",
            highlight=False,
        )
    return 0 if all(one.enough(possible) for one in found) else 1


if __name__ == "__main__":
    sys.exit(main())
