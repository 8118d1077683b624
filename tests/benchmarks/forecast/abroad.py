"""Forecasts on robots of different kinds: ``python -m tests.benchmarks.forecast.abroad FOLDER [--compute JOBS]``.

Every run is a comparison of its own in FOLDER, by default settings but for 60 generations. ``--compute`` makes those
that are missing. For each kind of robot it prints how many of the 90 % intervals hold, with the ends of the interval in
the code and with those that the other kinds give; the same for the chosen controllers; the mean error, and that of the
chosen controllers as a share of what they achieve above rest; and how often the choice is worse than controls at rest.
Every kind has the same weight in calibration.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from evaluation.prediction.scores import HORIZON
from evaluation.report.report import load_report
from evaluation.transfer.forecast import (
    FORECAST_RULE,
    Forecast,
    ForecastRule,
    forecast_of,
    model_weights,
    weighted_median,
)
from sysid_evo.validation.estimates import Estimate
from tests.benchmarks.markdown import add_markdown, print_tables

KINDS: dict[str, dict[str, Sequence[str]]] = {
    "cars": {
        f"{car}(seed={seed})": ("--minutes", minutes)
        for car, seed, minutes in (
            ("emulated_car", 11, "1"), ("emulated_car", 12, "2"), ("emulated_car", 13, "6"),
            ("awkward_car", 3, "3"), ("awkward_car", 4, "6"),
        )
    },
    "pendulums": {
        f"{robot}(seed={seed})": ("--minutes", minutes)
        for robot, minutes in (("pendulum", "1"), ("cart_pole", "2"))
        for seed in (1, 2, 3)
    },
    "heaters": {f"thermal(seed={seed})": ("--minutes", "30") for seed in (1, 2, 3)},
    "classic control": {
        'gymnasium(id="Pendulum-v1")': ("--minutes", "3"),
        'gymnasium(id="Acrobot-v1")': ("--minutes", "20"),
        'gymnasium(id="MountainCarContinuous-v0")': (),
        'gymnasium(id="CartPole-v1")': ("--rounds", "1"),
    },
    "MuJoCo": {
        'gymnasium(id="Reacher-v5")': (),
        'gymnasium(id="InvertedPendulum-v5")': ("--rounds", "1"),
    },
}  # fmt: skip
"""Robots by their kind, with further options of ``compare``."""
SEEDS = (2, 3)


@dataclass(frozen=True)
class Run:
    """A comparison of a robot of this kind, with the options of its command."""

    kind: str
    robot: str
    options: Sequence[str]
    seed: int

    @property
    def name(self) -> str:
        return "".join(letter if letter.isalnum() else "-" for letter in f"{self.robot} {self.seed}").strip("-")

    def compute(self, folder: Path) -> str:
        """Run the comparison in ``folder`` unless it is there, and return how it ended."""
        out = folder / self.name
        if (out / "report.json").is_file():
            return f"{self.name}: there"
        given = ("--robot", self.robot, "--seed", str(self.seed), "--out", str(out), *self.options)
        command = (sys.executable, "-m", "sysid_evo", "--quiet", "compare", *given)
        done = subprocess.run((*command, "--generations", "60", "--jobs", "1"), capture_output=True, text=True)
        return f"{self.name}: exit {done.returncode} {done.stderr[-300:] if done.returncode else ''}"


RUNS = tuple(
    Run(kind, robot, options, seed)
    for seed in SEEDS
    for kind, robots in KINDS.items()
    for robot, options in robots.items()
)


@dataclass(frozen=True)
class Case:
    """One evolved controller of a run: achieved fitness and its standard error, forecast, unit of the interval.

    ``gain`` is the difference of the forecast to controls at rest, ``rest`` what these achieve.
    """

    kind: str
    run: str
    achieved: float
    error: float
    forecast: float
    unit: float
    gain: float
    rest: float
    picked: bool

    def holds(self, low: float, high: float) -> bool:
        """Return whether the interval with these ends, in units, holds."""
        value, unit = self.forecast, self.unit
        return Forecast("", value, value + low * unit, value + high * unit, {}).covers(
            Estimate(self.achieved, self.error)
        )


def cases(run: Run, folder: Path, rule: ForecastRule = FORECAST_RULE) -> list[Case]:
    """Return the controllers that were evolved in models of a comparison; none if it is not in ``folder``."""
    if not (folder / run.name / "report.json").is_file():
        return []
    report = load_report(folder / run.name)
    assert report.controllers is not None
    assert report.transfer is not None
    assert report.prediction is not None
    families, robot = report.transfer.families, report.transfer.robot
    fitness = {(cell.controller, cell.column): np.array(cell.fitness) for cell in report.transfer.cells}
    models = [column for column in report.transfer.columns if column in {one.model for one in report.exploitability}]
    outside = {one.model: one.outside for one in report.exploitability}
    errors = {}
    for model in report.prediction.models:
        at = [score.n for score in model.scores if score.steps == HORIZON] or [score.n for score in model.scores[-1:]]
        errors[model.name] = at[0] if at else None
    found, between = [], replace(rule, low=0.0, high=1.0)
    for one in report.controllers.controllers:
        columns = [model for model in models if len(fitness.get((one.name, model), ()))]
        if not one.against or one.forecast is None or one.achieved is None or len(columns) < 2:
            continue
        rest = [fitness[REST, model].mean() if (REST, model) in fitness else 0.0 for model in columns]
        known = [errors.get(model) for model in columns]
        own = [families[model] in {families[label] for label in one.against} for model in columns]
        value, _, high = forecast_of(
            [fitness[one.name, model] for model in columns], known, own,
            outside=[outside[model].get(one.name) for model in columns], rest=rest, rule=between,
        )  # fmt: skip
        resting = fitness[REST, robot].mean() if (REST, robot) in fitness else 0.0
        floor = float(weighted_median(np.array(rest), model_weights(known, np.array(own), rule=rule)))
        found.append(
            Case(
                run.kind, run.name, one.achieved.value, one.achieved.standard_error, value, high - value,
                max(abs(value - floor), 1e-9), float(resting), one.name == report.controllers.pick,
            )
        )  # fmt: skip
    return found


REST = "rest"


def calibrated(found: Sequence[Case], share: float = FORECAST_RULE.share) -> tuple[float, float]:
    """Return between which multiples of their units ``share`` of the errors lie; all kinds have the same weight."""
    kinds = [one.kind for one in found]
    missed = np.array([(one.achieved - one.forecast) / max(one.unit, 1e-9 * one.gain) for one in found])
    weights = np.array([1.0 / kinds.count(kind) for kind in kinds])
    order = np.argsort(missed)
    at = (np.cumsum(weights[order]) - 0.5 * weights[order]) / weights.sum()
    low, high = np.interp([0.5 - share / 2, 0.5 + share / 2], at, missed[order])
    return float(low), float(high)


def kind_table(everyone: Sequence[Case]) -> Table:
    """Return a line for each kind of robot."""
    made = Table(
        "kind", "runs", "controllers", "intervals that hold", "calibrated on the others", "choices that hold",
        "width / gain", "error / gain, median", "mean", "of choices / achieved", "worse than rest",
    )  # fmt: skip
    for kind in dict.fromkeys(one.kind for one in everyone):
        own, others = ([one for one in everyone if (one.kind == kind) is mine] for mine in (True, False))
        low, high = FORECAST_RULE.low, FORECAST_RULE.high
        other = calibrated(others) if others else (np.nan, np.nan)
        picks = [one for one in own if one.picked]
        errors = np.clip([(one.forecast - one.achieved) / one.gain for one in own], -2.0, 2.0)
        of_picks = [(one.forecast - one.achieved) / max(abs(one.achieved - one.rest), 1e-9) for one in picks]
        made.add_row(
            kind,
            str(len({one.run for one in own})),
            str(len(own)),
            _share([one.holds(low, high) for one in own]),
            f"{_share([one.holds(*other) for one in own])} ({other[0]:.1f} to {other[1]:.1f})",
            _share([one.holds(low, high) for one in picks]),
            f"{np.median([(high - low) * one.unit / one.gain for one in own]):.2f}",
            f"{np.median(errors):+.2f}",
            f"{np.mean(errors):+.2f}",
            f"{np.mean(of_picks):+.2f}",
            f"{sum(one.achieved < one.rest - 2.0 * one.error for one in picks)} of {len(picks)}",
        )
    return made


def _share(held: Sequence[bool]) -> str:
    return f"{100 * np.mean(held):.0f} %" if held else "–"


def main(arguments: list[str] | None = None) -> int:
    """Make the missing comparisons and print the table."""
    parser = argparse.ArgumentParser(prog="tests.benchmarks.forecast.abroad", description=__doc__)
    parser.add_argument("folder", type=Path, help="folder of the comparisons")
    parser.add_argument("--compute", type=int, metavar="JOBS", help="first make those that are missing")
    add_markdown(parser)
    given, console = parser.parse_args(arguments), Console(width=150)
    if given.compute:
        with ThreadPoolExecutor(given.compute) as pool:
            for sentence in pool.map(lambda run: run.compute(given.folder), RUNS):
                console.print(sentence, highlight=False, markup=False)
    everyone = [one for run in RUNS for one in cases(run, given.folder)]
    print_tables((kind_table(everyone),), given.markdown, console)
    low, high = calibrated(everyone)
    console.print(
        f"of all kinds: low={low:.1f}, high={high:.1f}; in the code: {FORECAST_RULE.low}, {FORECAST_RULE.high}"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
