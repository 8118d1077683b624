"""Accuracy of forecasts of the fitness on the robot: ``python -m tests.benchmarks.forecast RUN ...``.

    python -m tests.benchmarks.forecast RUN ... --out FOLDER
    python -m tests.benchmarks.forecast --study STUDY.toml --store FOLDER --out FOLDER

Every RUN is the folder of a comparison on an emulated car, as made by ``sysid-evo compare --seed 2``. A study
(``sysid-evo study``) has many of them in one store; its points with all models and controllers are used, and
``--compute JOBS`` computes them without the transfer matrices. All finalists are run on all models of their run and, in
other trials, on the car; results are stored in ``--out``. Further terms are tested in single runs only, where they take
most of the time. Prints the rank correlation with the achieved fitness within a run (means over runs, 95 % intervals
over cars), the error, and the loss from choosing the best of ten; the coverage of 90 % intervals, with each car
calibrated on the others; the benefit of further terms; and the constants of `FORECAST_RULE`.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from evaluation.report.report import load_report
from evaluation.study.study import Study
from evaluation.transfer.forecast import FORECAST_RULE
from tests.benchmarks.forecast.judging import (
    Seen,
    asked_only,
    best_of_ten,
    calibrated,
    held,
    over_cars,
    rank_correlation,
    seen,
    with_term,
)
from tests.benchmarks.forecast.looking import look
from tests.benchmarks.forecast.points import complete_points, compute_points, look_at
from tests.benchmarks.markdown import add_markdown, print_tables

FIGURES: Mapping[str, Callable[[Seen], float]] = {
    "forecast": lambda one: one.forecast,
    "median on other families": lambda one: one.others,
    "claimed": lambda one: one.claimed,
    "prediction error of its models, negative": lambda one: -one.error,
}
Runs = Mapping[tuple[int, str], Sequence[Seen]]


def interval(found: tuple[float, float, float], digits: int = 3) -> str:
    """Return a mean and its interval as text."""
    mean, low, high = (f"{value:.{digits}f}" for value in found)
    return f"{mean} ({low} to {high})"


def figure_table(runs: Runs) -> Table:
    """Return a line for each figure by which controllers could be ranked."""
    made = Table("figure", "rank correlation", "lowest", "RMSE", "loss of the best of ten")
    everyone = [one for found in runs.values() for one in found]
    for name, figure in FIGURES.items():
        ranks = {key: rank_correlation(found, figure) for key, found in runs.items()}
        losses = {key: best_of_ten(found, figure) for key, found in runs.items()}
        misses = [figure(one) - one.achieved for one in everyone]
        error = f"{np.sqrt(np.mean(np.square(misses))):.2f}" if not name.startswith("prediction") else "–"
        made.add_row(name, interval(over_cars(ranks)), f"{min(ranks.values()):.2f}", error, interval(over_cars(losses)))
    return made


def term_table(runs: Runs) -> Table:
    """Return a line for each further term: the forecast with this term, fitted on the other cars."""
    made = Table("term", "rank correlation", "RMSE")
    keys = [key for key, found in runs.items() for _ in found]
    everyone = [one for found in runs.values() for one in found]
    for name in everyone[0].terms:
        values = with_term(everyone, name)
        better = [replace(one, forecast=float(value)) for one, value in zip(everyone, values, strict=True)]
        ranks = {
            key: rank_correlation(
                [one for own, one in zip(keys, better, strict=True) if own == key], FIGURES["forecast"]
            )
            for key in runs
        }
        error = np.sqrt(np.mean([(one.forecast - one.achieved) ** 2 for one in better]))
        made.add_row(name, interval(over_cars(ranks)), f"{error:.2f}")
    return made


def cover_table(runs: Runs) -> Table:
    """Return a line for each car: which share of the intervals holds."""
    everyone = [one for found in runs.values() for one in found]
    holds = np.array(held(everyone, FORECAST_RULE.share))
    cars = np.array([one.car for one in everyone])
    in_code = np.array(
        [
            one.forecast + FORECAST_RULE.low * one.unit <= one.achieved <= one.forecast + FORECAST_RULE.high * one.unit
            for one in everyone
        ]
    )
    made = Table("car", "controllers", "intervals that hold", "those of the code")
    for car in np.unique(cars):
        own = cars == car
        made.add_row(str(car), str(own.sum()), f"{100 * holds[own].mean():.0f} %", f"{100 * in_code[own].mean():.0f} %")
    keys = [key for key, found in runs.items() for _ in found]
    shares = {key: float(holds[[own == key for own in keys]].mean()) for key in runs}
    told = f"{100 * holds.mean():.1f} %; mean over runs {interval(over_cars(shares))}"
    made.add_row("all", str(len(cars)), told, f"{100 * in_code.mean():.1f} %")
    return made


def missed_table(runs: Runs) -> Table:
    """Return a line for each kind of controller: coverage of the intervals and error of the forecasts."""
    everyone = [one for found in runs.values() for one in found]
    holds = np.array(held(everyone, FORECAST_RULE.share))
    made = Table("controller, or its search", "finalists", "intervals that hold", "achieved less forecast", "by car")
    for name in dict.fromkeys(one.name for one in everyone):
        own = np.array([one.name == name for one in everyone])
        missed = np.array([one.achieved - one.forecast for one in everyone])
        cars = sorted({one.car for one in everyone if one.name == name})
        by_car = [holds[own & np.array([one.car == car for one in everyone])].mean() for car in cars]
        shares = " ".join(f"{100 * share:.0f}" for share in by_car)
        made.add_row(name, str(own.sum()), f"{100 * holds[own].mean():.0f} %", f"{missed[own].mean():+.2f}", shares)
    return made


def number_of(robot: str) -> int:
    """Return the number of an emulated car, 0 for the usual one."""
    return int("".join(letter for letter in robot if letter.isdigit()) or 0)


def main(arguments: list[str] | None = None) -> int:
    """Compute missing records and print the tables."""
    parser = argparse.ArgumentParser(prog="tests.benchmarks.forecast", description=__doc__)
    parser.add_argument("runs", nargs="*", type=Path, help="run folders of comparisons of emulated cars")
    parser.add_argument("--study", type=Path, help="file of a study of emulated cars")
    parser.add_argument("--store", type=Path, help="folder that holds the cells of the study")
    parser.add_argument("--out", type=Path, required=True, help="folder that keeps what was seen")
    parser.add_argument("--compute", type=int, metavar="JOBS", help="first compute what the store lacks")
    parser.add_argument("--models", help="labels, separated by commas: ask these alone, of controllers evolved in them")
    console, runs = Console(width=120), {}
    add_markdown(parser)
    given = parser.parse_args(arguments)
    given.out.mkdir(parents=True, exist_ok=True)
    if (given.study is None) != (given.store is None):
        parser.error("--study needs --store, and the other way round")
    if given.study is not None:
        if given.compute:
            compute_points(Study.read(given.study), given.store, given.compute)
        for point, comparison in complete_points(Study.read(given.study), given.store):
            car = number_of(comparison.experiment.robot or "")
            records = look_at(point, comparison, given.store, given.out)
            if given.models:
                records = asked_only(records, given.models.split(","))
            runs[car, point.name] = [seen(record, car, point.name, FORECAST_RULE) for record in records]
            console.print(f"{point.name}: {len(records)} controllers, {time.process_time():.0f} s", highlight=False)
    for run in given.runs:
        robot = load_report(run).run.settings["robot"]
        car = number_of(robot)
        key = (car, str(run))
        runs[key] = [seen(record, car, str(run), FORECAST_RULE) for record in look(run, given.out)]
    everyone = [one for found in runs.values() for one in found]
    console.print(f"{len(everyone)} controllers in {len(runs)} runs of {len({car for car, _ in runs})} cars")
    terms = (term_table(runs),) if all(one.terms for one in everyone) else ()
    print_tables((figure_table(runs), cover_table(runs), missed_table(runs), *terms), given.markdown, console)
    low, high = calibrated(everyone, FORECAST_RULE.share)
    console.print(
        f"of all cars: low={low:.1f}, high={high:.1f}; in the code: low={FORECAST_RULE.low}, high={FORECAST_RULE.high}"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
