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

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.data import Dataset, Trajectory
from sysid_evo.engine import DynamicsRunner, rollout
from sysid_evo.evolution import evolve
from sysid_evo.evolution.controller_evolution import EnsembleObjective
from sysid_evo.evolution.strategies.mu_plus_lambda import MuPlusLambda
from sysid_evo.models import Disturbed, Dynamics
from sysid_evo.models.base import make_model
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import Spec, make_robot
from sysid_evo.tasks import PointToPoint
from sysid_evo.testing import example_dataset
from sysid_evo.types import Array
from tests.benchmarks.markdown import add_markdown, print_tables
from tests.benchmarks.timing import in_turn

SEED = 1
TRIALS = 10
N_PARAMETERS = 78
LATER = 10_000  # a generation that evolution does not reach: fresh trials
MODELS = "parametrised, backprop27, sindy_discrete, nearest_neighbour, mlp_ensemble, neural_ode"
QUICK_MODELS = "parametrised(generations=5), backprop27(epochs=20), sindy_discrete, nearest_neighbour, linear"


def evolved(dynamics: Dynamics, task: PointToPoint, candidates: int, generations: int) -> Array:
    """Return the population (candidates, 78) after ``generations`` on ``dynamics``."""
    strategy = MuPlusLambda(
        n_parameters=N_PARAMETERS, seed=SEED, parents=candidates // 2, children=candidates - candidates // 2
    )
    objective = EnsembleObjective((DynamicsRunner(dynamics),), RecurrentNetwork(), task, SEED, TRIALS)
    for _ in evolve(strategy, objective, generations):
        pass
    return strategy.ask()


def recording(episodes: int, steps: int) -> Dataset:
    """Return episodes of the made-up car without their first second.

    All of them begin at exactly zero; a nearest neighbour may choose any of such equal points.
    """
    dataset = example_dataset(episodes=episodes, steps=steps)
    return dataset.with_episodes(
        [Trajectory(e.states[20:], e.controls[20:], e.dt, name=e.name) for e in dataset.episodes]
    )


def measure(name: str, dynamics: Dynamics, task: PointToPoint, population: Array, repeats: int) -> dict[str, Any]:
    """Return one row: speeds in million steps per second, and their ratios."""
    controller, seeds = RecurrentNetwork(), trial_seeds(SEED, TRIALS, generation=LATER)

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
        "model": name,
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
    parser.add_argument("--models", help="instead of some of each kind")
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
        models = {"emulated_car": make_robot("emulated_car").dynamics}
        for spec in Spec.parse_many(chosen.models or (QUICK_MODELS if chosen.quick else MODELS)):
            models[spec.label] = make_model(spec).fit(dataset, rng=np.random.default_rng(0))
        for name, dynamics in models.items():
            population = evolved(dynamics, task, candidates, generations)
            rows.append(measure(name, dynamics, task, population, repeats))
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
