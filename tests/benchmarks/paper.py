"""Reproduction of the paper's claims on the emulated car: ``python -m tests.benchmarks.paper --out FOLDER``.

For each seed a comparison with the preset ``paper`` is made in ``FOLDER/seed-S``: the paper's four families, its two
ensembles with the minimum, its evolution strategy and its number of generations. Finished comparisons are not repeated.
Then each claim is tested on each comparison: it is *reproduced* if it holds with every seed, *not* if with none,
*partly* otherwise. Prints a row for each claim with the numbers of each seed.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.stats import spearmanr

from evaluation import compare
from evaluation.results import ComparisonResults
from evaluation.transfer.matrix import TransferMatrix
from sysid_evo.controllers.controller import make_controller
from sysid_evo.engine import DynamicsRunner, behaviour_names
from sysid_evo.evolution import Champion
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import make_robot
from sysid_evo.tasks.task import make_task
from tests.benchmarks.markdown import add_markdown, print_tables

ROBOT = "emulated_car"
TRIALS = 300
COMPLETED = 5.0
"""Waypoints on its own model from which on a controller is taken to do the task: once around the arena."""
BACKWARDS = 0.5


@dataclass(frozen=True)
class Claim:
    """A claim of the paper, and its test on a comparison: whether it holds, and the numbers."""

    sentence: str
    test: Callable[[ComparisonResults], tuple[bool, str]]


def matrix_of(report: ComparisonResults) -> TransferMatrix:
    assert report.matrix is not None
    assert report.matrix.robot is not None
    return report.matrix


def models_of(matrix: TransferMatrix) -> list[str]:
    return [column for column in matrix.columns if column != matrix.robot]


def singles(matrix: TransferMatrix) -> list[Champion]:
    return [champion for champion in matrix.champions if len(champion.against) == 1]


def ensembles(matrix: TransferMatrix) -> list[Champion]:
    return [champion for champion in matrix.champions if len(champion.against) > 1]


def own(matrix: TransferMatrix, champion: Champion) -> float:
    return matrix.cell(champion.name, champion.against[0]).mean


def achieved(matrix: TransferMatrix, champion: Champion) -> float:
    assert matrix.robot is not None
    return matrix.cell(champion.name, matrix.robot).mean


def worst_share(matrix: TransferMatrix, champion: Champion) -> float:
    """Return the lowest share that a controller has, over the models, of the best there."""
    best = {model: max(matrix.cell(one.name, model).mean for one in matrix.champions) for model in models_of(matrix)}
    return min(matrix.cell(champion.name, model).mean / best[model] for model in best)


def backwards(champion: Champion) -> float:
    """Return which share of the time a controller drives the car backwards."""
    dynamics = make_robot(ROBOT).dynamics
    assert dynamics is not None
    task = make_task(champion.task).bind(dynamics.system)
    controller = make_controller(champion.controller).bind_to(task)
    ran = DynamicsRunner(dynamics).bind(controller, task)(champion.parameters[None], trial_seeds(0, TRIALS))
    names = behaviour_names(dynamics.system)
    return float(ran.behaviour[0, :, names.index("forward_speed below")].mean())


def tabled(values: Iterable[tuple[str, float]], digits: int = 1) -> str:
    return ", ".join(f"{name} {value:.{digits}f}" for name, value in values)


def evolves(report: ComparisonResults) -> tuple[bool, str]:
    claims = [(one.name, own(matrix_of(report), one)) for one in singles(matrix_of(report))]
    return min(value for _, value in claims) >= COMPLETED, tabled(claims)


def best_at_home(report: ComparisonResults) -> tuple[bool, str]:
    matrix = matrix_of(report)
    best = {
        model: max(singles(matrix), key=lambda one: matrix.cell(one.name, model).mean).against[0]
        for model in models_of(matrix)
    }
    away = {model: winner for model, winner in best.items() if winner != model}
    told = ", ".join(f"on {model} that of {winner}" for model, winner in away.items())
    return not away, f"{len(best) - len(away)} of {len(best)}" + (f"; {told}" if told else "")


def exploitable(report: ComparisonResults) -> tuple[bool, str]:
    matrix = matrix_of(report)
    kept = [(one.name, achieved(matrix, one) / own(matrix, one)) for one in singles(matrix)]
    return min(kept, key=lambda pair: pair[1])[0] == "evolved3", tabled(kept, 2)


def consistent(report: ComparisonResults) -> tuple[bool, str]:
    matrix = matrix_of(report)
    shares = [(one.name, worst_share(matrix, one)) for one in matrix.champions]
    best = max(shares, key=lambda pair: pair[1])[0]
    return best in [one.name for one in ensembles(matrix)], tabled(shares, 2)


def robust(report: ComparisonResults) -> tuple[bool, str]:
    matrix = matrix_of(report)
    ends = [(one.name, achieved(matrix, one)) for one in (*singles(matrix), *ensembles(matrix))]
    alone = np.mean([achieved(matrix, one) for one in singles(matrix)])
    return min(achieved(matrix, one) for one in ensembles(matrix)) > float(alone), tabled(ends)


def best_single(report: ComparisonResults) -> tuple[bool, str]:
    matrix = matrix_of(report)
    alone, together = (max(achieved(matrix, one) for one in group) for group in (singles(matrix), ensembles(matrix)))
    return alone > together, f"{alone:.1f} against {together:.1f}"


def drives_backwards(report: ComparisonResults) -> tuple[bool, str]:
    shares = [(one.name, backwards(one)) for one in matrix_of(report).champions]
    most = np.mean([share > BACKWARDS for _, share in shares])
    return bool(most > BACKWARDS), tabled(shares, 2)


def table_1(report: ComparisonResults) -> tuple[bool, str]:
    assert report.prediction is not None
    errors = {}
    for model in models_of(matrix_of(report)):
        score = report.prediction.model(model).score(None)
        assert score is not None
        errors[model] = score.rmse
    near, far = ("parametrised", "nearest_neighbour"), ("backprop27", "evolved3")
    holds = all(errors[a][channel] < errors[b][channel] for a in near for b in far for channel in (0, 2))
    return holds, tabled(((model, error[2]) for model, error in errors.items()), 2) + " rad/s"


def error_tells_nothing(report: ComparisonResults) -> tuple[bool, str]:
    assert report.prediction is not None
    matrix = matrix_of(report)
    errors = [report.prediction.model(one.name).score(None) for one in singles(matrix)]
    n = [error.n for error in errors if error is not None]
    correlation = float(spearmanr(n, [achieved(matrix, one) for one in singles(matrix)]).statistic)
    return correlation > -BACKWARDS, f"rank correlation {correlation:+.1f}"


CLAIMS = (
    Claim("In each model a controller that does the task evolves within 300 generations", evolves),
    Claim("On each model, that evolved there is the best of the single-model ones", best_at_home),
    Claim("evolved3 is the most exploitable model (least kept of its claim on the car)", exploitable),
    Claim("Nearest neighbour and parametrised predict better than the other two (Table 1)", table_1),
    Claim("The most consistent controller over the models is a multi-model one", consistent),
    Claim("Multi-model controllers do better on the car than single-model ones on average", robust),
    Claim("The best on the car is nevertheless a single-model one", best_single),
    Claim("Most controllers drive backwards", drives_backwards),
    Claim("The prediction error does not show which model gives the best controller", error_tells_nothing),
)


def verdict(held: list[bool]) -> str:
    """Return the word for a claim that held, or not, with each seed."""
    return "reproduced" if all(held) else "partly" if any(held) else "not"


def table(reports: list[ComparisonResults]) -> Table:
    """Return a row for each claim."""
    made = Table(title=f"the paper's claims on {ROBOT}, {len(reports)} seeds", show_lines=True)
    for name in ("claim", "verdict", "held", "numbers, seed by seed"):
        made.add_column(name)
    for claim in CLAIMS:
        found = [claim.test(report) for report in reports]
        held = [holds for holds, _ in found]
        numbers = "\n".join(text for _, text in found)
        made.add_row(claim.sentence, verdict(held), f"{sum(held)} of {len(held)}", numbers)
    return made


def main(arguments: list[str] | None = None) -> int:
    """Make the comparisons that are missing and print the table."""
    parser = argparse.ArgumentParser(prog="tests.benchmarks.paper", description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=int, default=3)
    add_markdown(parser)
    given = parser.parse_args(arguments)
    reports = [
        compare(out=given.out / f"seed-{seed}", robot=ROBOT, preset="paper", transfer_trials=TRIALS, seed=seed)
        for seed in range(given.seeds)
    ]
    print_tables([table(reports)], given.markdown, Console(width=120))
    return 0


if __name__ == "__main__":
    sys.exit(main())
