"""What controllers achieve on cars they never met: ``python -m tests.benchmarks.transfer --out FOLDER``.

For every car and seed a comparison is made in ``FOLDER/car-C-seed-S`` (``sysid-evo compare`` of the emulated car,
recorded for ``--minutes``): a controller for each family, for the paper's two ensembles, and by the recommended
recipe. What is done stands there and is not done again. The yardstick of a car is the best that any controller is
known to achieve on it: of these runs, of the ``--yardsticks`` file of `tests.benchmarks.search`, or evolved on the car
itself (``--yardstick``). Prints the share of the yardstick that each kind of controller achieves, mean and worst, what
it claims above that, with 95 % bootstrap intervals over cars and seeds, and the paired difference to the recipe.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from evaluation import compare
from evaluation.comparison.champion_cells import RECOMMENDED
from evaluation.transfer import TransferMatrix
from sysid_evo.arrays import Array
from sysid_evo.registry import split

FAMILIES = "parametrised,sindy,narx,backprop27,hybrid_ode,nearest_neighbour,evolved3"
PAPER = ("evolved3+nearest_neighbour", "backprop27+nearest_neighbour+parametrised")
TRIALS = 300
RESAMPLES = 4000


@dataclass(frozen=True)
class Row:
    """One controller on one car: what it claims where it was evolved, and what it achieves, in waypoints."""

    controller: str
    car: int
    seed: int
    claimed: float
    achieved: float


def rows(matrix: TransferMatrix, car: int, seed: int) -> Iterable[Row]:
    """Yield a row for each controller of a comparison. The claim against several models is the lowest of them."""
    assert matrix.robot is not None
    for champion in matrix.champions:
        claims = [matrix.cell(champion.name, column).mean for column in champion.against if column in matrix.columns]
        yield Row(champion.name, car, seed, min(claims), matrix.cell(champion.name, matrix.robot).mean)


def interval(values: Array, seed: int = 0) -> str:
    """Return the mean and its 95 % bootstrap interval as text."""
    rng = np.random.default_rng(seed)
    drawn = rng.choice(values, size=(RESAMPLES, len(values))).mean(axis=1)
    low, high = np.quantile(drawn, [0.025, 0.975])
    return f"{values.mean():+.2f} ({low:+.2f} to {high:+.2f})"


def table(found: list[Row], yardsticks: dict[int, float]) -> Table:
    """Return a line for each kind of controller, the best on average first."""
    made = Table(title=f"{len({(row.car, row.seed) for row in found})} cells of car and seed")
    for name in ("controller", "share, mean", "worst", "claimed - achieved", "recipe minus this, share"):
        made.add_column(name, justify="left" if name == "controller" else "right")
    shares = {(row.controller, row.car, row.seed): row.achieved / yardsticks[row.car] for row in found}
    names = dict.fromkeys(row.controller for row in found)
    mean = {name: float(np.mean([value for key, value in shares.items() if key[0] == name])) for name in names}
    for name in sorted(names, key=lambda name: -mean[name]):
        own = [row for row in found if row.controller == name]
        cells = [(row.car, row.seed) for row in own]
        paired = [shares[RECOMMENDED, *cell] - shares[name, *cell] for cell in cells if (RECOMMENDED, *cell) in shares]
        made.add_row(
            name,
            f"{mean[name]:.2f}",
            f"{min(shares[name, *cell] for cell in cells):.2f}",
            interval(np.array([row.claimed - row.achieved for row in own])),
            "" if name == RECOMMENDED or not paired else interval(np.array(paired)),
        )
    return made


def main(arguments: list[str] | None = None) -> int:
    """Make the comparisons that are missing and print the table."""
    parser = argparse.ArgumentParser(prog="tests.benchmarks.transfer", description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--cars", default="0,1,2,3,4", help="0 is the usual car, 1, 2, ... are perturbed")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--minutes", type=float, default=6.0)
    parser.add_argument("--models", default=FAMILIES)
    parser.add_argument("--preset", default="quick")
    parser.add_argument("--generations", type=int)
    parser.add_argument("--aggregate", default="min")
    parser.add_argument("--noise", default="", help="what controllers meet in evolution, envelope(...)")
    parser.add_argument("--caution", default="", help="what they lose where models are doubted, doubt(...)")
    parser.add_argument("--yardstick", action="store_true", help="evolve on each car itself as well")
    parser.add_argument("--yardsticks", type=Path, help="what tests.benchmarks.search kept with --json")
    given = parser.parse_args(arguments)
    models = tuple(split(given.models))
    console, found = Console(width=110), []
    for car in map(int, given.cars.split(",")):
        for seed in range(given.seeds):
            report = compare(
                out=given.out / f"car-{car}-seed-{seed}",
                robot=f"emulated_car(seed={car})" if car else "emulated_car",
                minutes=given.minutes,
                models=models,
                ensembles=tuple(name for name in PAPER if set(name.split("+")) <= set(models)),
                preset=given.preset,
                generations=given.generations,
                aggregate=given.aggregate,
                noise=given.noise,
                caution=given.caution,
                transfer_trials=TRIALS,
                traces=0,
                yardstick=given.yardstick,
                seed=seed,
            )
            assert report.matrix is not None
            new = list(rows(report.matrix, car, seed))
            found += new
            told = ", ".join(f"{row.controller} {row.claimed:.1f} -> {row.achieved:.1f}" for row in new)
            console.print(f"car {car}, seed {seed}: {told}", highlight=False)
    kept = json.loads(given.yardsticks.read_text()) if given.yardsticks else []
    best = {
        car: max(
            [row.achieved for row in found if row.car == car] + [one["achieved"] for one in kept if one["car"] == car]
        )
        for car in dict.fromkeys(row.car for row in found)
    }
    console.print("yardsticks: " + ", ".join(f"car {car} {value:.1f}" for car, value in best.items()), highlight=False)
    console.print(table([row for row in found if not row.controller.startswith("emulated_car")], best))
    return 0


if __name__ == "__main__":
    sys.exit(main())
