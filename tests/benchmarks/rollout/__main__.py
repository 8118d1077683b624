"""Speed of rollouts: ``python -m tests.benchmarks.rollout``.

For each model, a population of evolved controllers is rolled out in turn in one process: by the compiled engine on one
and two threads, in the model within an empty `Disturbed`, and by the NumPy reference. Speeds and ratios are medians of
the processor time, which other processes affect least; only the two threads are compared by wall time.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.engine import DynamicsRunner, rollout
from sysid_evo.evolution import EnsembleObjective, MuPlusLambda, evolve
from sysid_evo.models import Disturbed, Dynamics
from sysid_evo.randomness import trial_seeds
from sysid_evo.tasks import PointToPoint
from sysid_evo.types import Array
from tests.benchmarks.markdown import add_markdown, print_tables
from tests.benchmarks.rollout.families import Case, cases, recording
from tests.benchmarks.rollout.timing import in_turn

SEED = 1
TRIALS = 10
N_PARAMETERS = 78
LATER = 10_000  # a generation that evolution does not reach: fresh trials


def evolved(dynamics: Dynamics, task: PointToPoint, candidates: int, generations: int) -> Array:
    """Return the population (candidates, 78) after ``generations`` on ``dynamics``."""
    strategy = MuPlusLambda(
        n_parameters=N_PARAMETERS, seed=SEED, parents=candidates // 2, children=candidates - candidates // 2
    )
    objective = EnsembleObjective((DynamicsRunner(dynamics),), RecurrentNetwork(), task, SEED, TRIALS)
    for _ in evolve(strategy, objective, generations):
        pass
    return strategy.ask()


def measure(case: Case, task: PointToPoint, population: Array, repeats: int) -> dict[str, Any]:
    """Return one row: speeds in million steps per second, and their ratios."""
    dynamics, controller = case.dynamics, RecurrentNetwork()
    seeds = trial_seeds(SEED, TRIALS, generation=LATER)

    def fast(threads: int, dynamics: Dynamics = dynamics) -> Array:
        return rollout(dynamics, controller, population, task, seeds, engine="float32", threads=threads).fitness

    undisturbed = Disturbed(dynamics)
    programs: dict[str, Callable[[], object]] = {
        "one_thread": lambda: fast(1),
        "undisturbed": lambda: fast(1, undisturbed),
        "two_threads": lambda: fast(2),
        "numpy": lambda: rollout(dynamics, controller, population, task, seeds, engine="reference"),
    }
    timings = in_turn(programs, repeats=repeats, shortest=0.03)
    steps = population.shape[0] * TRIALS * task.horizon / 1e6
    one, two = timings["one_thread"], timings["two_threads"]
    return {
        "model": case.name,
        "mean_fitness": float(fast(1).mean()),
        "million_steps_per_second": {
            name: steps / (timing.wall if name == "two_threads" else timing.processor)
            for name, timing in timings.items()
        },
        "seconds": {name: {"processor": t.processor, "wall": t.wall} for name, t in timings.items()},
        "ratio_to_numpy": timings["numpy"].processor / one.processor,
        "ratio_of_two_threads": one.wall / two.wall,
        "time_with_nothing_that_disturbs": timings["undisturbed"].processor / one.processor,
    }


def speeds(rows: Sequence[dict[str, Any]]) -> Table:
    """Return ``rows``, which are what `measure` returns, as a table of at most 80 columns."""
    table = Table(title="Million environment steps per second", box=SIMPLE_HEAD, padding=(0, 1), collapse_padding=True)
    for column in ("model", "goals", "1 thr.", "2 thr.", "NumPy", "1/NumPy", "2/1", "zero"):
        table.add_column(column, justify="left" if column == "model" else "right", no_wrap=True)
    for row in rows:
        speed = row["million_steps_per_second"]
        table.add_row(
            row["model"],
            f"{row['mean_fitness']:.1f}",
            *(f"{speed[form]:.1f}" for form in ("one_thread", "two_threads", "numpy")),
            f"{row['ratio_to_numpy']:.1f}",
            f"{row['ratio_of_two_threads']:.2f}",
            f"{row['time_with_nothing_that_disturbs']:.2f}",
        )
    return table


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, print the table, perhaps write JSON."""
    parser = argparse.ArgumentParser(prog="tests.benchmarks.rollout", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="small populations and one repeat: does it run?")
    parser.add_argument("--models", nargs="*", default=[], help="only models whose names contain one of these")
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    add_markdown(parser)
    chosen = parser.parse_args(arguments)
    candidates, generations, repeats = (10, 2, 1) if chosen.quick else (100, 60, chosen.repeats)
    task = PointToPoint(horizon=50 if chosen.quick else 500)
    load = os.getloadavg()[0]
    console, rows = Console(), []
    dataset = recording(episodes=2 if chosen.quick else 12, steps=600)
    with threadpool_limits(1):
        for case in cases(dataset, generations=5 if chosen.quick else 60):
            if chosen.models and not any(part in case.name for part in chosen.models):
                continue
            population = evolved(case.dynamics, task, candidates, generations)
            rows.append(measure(case, task, population, repeats))
    print_tables([speeds(rows)], chosen.markdown, console)
    console.print(
        "goals: mean fitness; thr.: threads. zero: time with nothing that disturbs to time without. "
        "Processor time, but 2 thr. and 2/1 by the clock; "
        f"load average at the start {load:.1f} on {os.cpu_count()} processors."
    )
    if chosen.json is not None:
        chosen.json.write_text(json.dumps({"load": load, "models": rows}, indent=1))


if __name__ == "__main__":
    main()
