"""Errors and times of the car's grey boxes on two real cars and the emulated one.

    python -m tests.benchmarks.grey_box [--logs slippery_20hz free_20hz emulated_car] [--seeds 1] [--parameters]

N is the mean over channels of RMSE / standard deviation after 1, 10, 20 and 60 steps, and over the seeds. The peer is a
bicycle model with Pacejka tyres, fitted manually to the real cars. Times are processor times; the first fit of a law
includes compilation.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np
from rich.console import Console
from rich.table import Table

from evaluation.prediction.cases import PredictionProtocol, measured_cases
from evaluation.prediction.scoring import assess_model
from model_zoo.grey_box import GreyBox
from sysid_evo.models.base import make_model
from tests.benchmarks.cars import EMULATED, TEST_EPISODE, recording
from tests.benchmarks.markdown import add_markdown, print_tables, thousandths

PEER = {"slippery_20hz": (0.121, 0.38, 0.44, 0.47), "free_20hz": (0.129, 0.29, 0.33, 0.37)}
FAMILIES = (
    "parametrised",
    "single_track",
    "single_track(tyre=tanh)",
    "single_track(residual=true)",
    "single_track(residual=true, residual_points=60)",
)


def row(family: str, log: str, seeds: int, *, parameters: bool) -> tuple[str, float]:
    """Return N of a family at each horizon on one log, as text, and the shortest time of a fit in s."""
    training, test = recording(log)
    cases = measured_cases(training, test, PredictionProtocol())
    rows, seconds = [], []
    for seed in range(seeds):
        model, began = make_model(family), time.process_time()
        model.fit(training, rng=np.random.default_rng(seed))
        seconds.append(time.process_time() - began)
        scored = assess_model(family, model, cases, family=family)
        rows.append([score.n for horizon in cases.horizons if (score := scored.score(horizon))])
        if seed == 0 and parameters and isinstance(model, GreyBox):
            write_parameters(model)
    return thousandths(np.mean(rows, axis=0)), min(seconds)


def write_parameters(model: GreyBox) -> None:
    """Write the parameters with their standard errors, and those that are not determined."""
    for found in model.parameters_table():
        mark = "" if found["determined"] else "  not determined"
        sys.stdout.write(f"    {found['parameter']:20s} {found['value']:9.4f} +- {found['standard error']:.4f} ")
        sys.stdout.write(f"{found['unit']}{mark}\n")
    for sentence in model.undetermined_:
        sys.stdout.write(f"    {sentence}\n")


def main(arguments: list[str] | None = None) -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--logs", nargs="+", default=[*TEST_EPISODE, EMULATED], choices=[*TEST_EPISODE, EMULATED])
    parser.add_argument("--families", nargs="+", default=FAMILIES)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--parameters", action="store_true", help="also print the parameters of the first seed")
    add_markdown(parser)
    given = parser.parse_args(arguments)
    table = Table("family", *given.logs, "fit, s")
    if PEER.keys() & set(given.logs):
        table.add_row("bicycle model with Pacejka tyres", *(thousandths(PEER.get(log, ())) for log in given.logs), "")
    for family in given.families:
        found = []
        for log in given.logs:
            found.append(row(family, log, given.seeds, parameters=given.parameters))
            sys.stdout.write(f"{log}, {family}: {found[-1][0]}, {found[-1][1]:.1f} s\n")
            sys.stdout.flush()
        seconds = [f"{taken:.0f}" for _, taken in sorted(found, key=lambda one: one[1])]
        taken = seconds[0] if seconds[0] == seconds[-1] else f"{seconds[0]} to {seconds[-1]}"
        table.add_row(f"`{family}`", *(text for text, _ in found), taken)
    print_tables([table], given.markdown, Console(width=140))


if __name__ == "__main__":
    main()
