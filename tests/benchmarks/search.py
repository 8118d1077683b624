"""Comparison of evolution strategies: ``python -m tests.benchmarks.search [--cars 0,1] [--seeds 5]``.

Controllers are evolved on emulated cars, from random starts, by several strategies with the same number of rollouts
(that of ``--generations`` generations of 100 candidates in 10 trials). The score of a run is the mean fitness of its
champion in 300 fresh trials. The reference of a car is the best of all runs on it, or ``--reference`` if that is
higher. Prints a table: mean, best, share of runs that reach 95 % of the reference, processor seconds, and the share of
`ask` and `tell` in them. ``--json FILE`` stores all runs; a stored run is not repeated.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from sysid_evo.engine import DynamicsRunner, behaviour_names
from sysid_evo.evolution import ControllerEvolution
from sysid_evo.evolution.controller_evolution import EnsembleObjective, selection_seeds
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import make_robot
from sysid_evo.types import Array
from tests.benchmarks.markdown import add_markdown, print_tables

PLAIN_CANDIDATES, PLAIN_TRIALS = 100, 10
REACHED = 0.95
FRESH = 300
TEST_SEED = 2**20

STRATEGIES = {
    "plain": ("recurrent", "mu_plus_lambda", 10),
    "CMA-ES, narrow": ("recurrent", "cma_es(sigma=0.5)", 10),
    "CMA-ES, wide": ("recurrent", "cma_es", 10),
    "niches, six hidden units": ("recurrent", "niches", 10),
    "niches, ten trials": ("recurrent(hidden=10)", "niches", 10),
    "niches, six hidden units, five trials": ("recurrent", "niches", 5),
    "recommended": ("recurrent(hidden=10)", "niches", 5),
}
"""What is compared: controller, strategy, trials of a candidate in a generation."""


@dataclass(frozen=True)
class Run:
    """One evolution on one car: use of its budget and fitness of its champion."""

    strategy: str
    car: int
    seed: int
    rollouts: int
    achieved: float
    niche: str
    seconds: float
    bookkeeping: float


def run(strategy: str, car: int, seed: int, generations: int) -> Run:
    """Evolve on a car by one of `STRATEGIES` until the budget of ``generations`` plain generations is spent."""
    controller_name, spec, trials = STRATEGIES[strategy]
    settings = ControllerEvolution(controller=controller_name, strategy=spec, trials=trials)
    dynamics = make_robot(f"emulated_car(seed={car})" if car else "emulated_car").dynamics
    assert dynamics is not None
    task = settings.make_task(dynamics.system)
    controller = settings.make_controller(task)
    objective = EnsembleObjective((DynamicsRunner(dynamics),), controller, task, seed, trials)
    search = settings.make_strategy(controller.n_parameters, seed)
    budget = generations * PLAIN_CANDIDATES * PLAIN_TRIALS
    cycles = round(budget / trials / PLAIN_CANDIDATES)
    search.prepare(
        behaviour_names=behaviour_names(dynamics.system),
        control_names=dynamics.system.control_names,
        generations=cycles,
    )
    began, asking, spent, generation = time.process_time(), 0.0, 0, 0
    while spent < budget:
        before = time.process_time()
        population = search.ask()
        asking += time.process_time() - before
        scores = objective(population, generation)
        before = time.process_time()
        search.tell(population, scores.fitness, scores.behaviour)
        asking += time.process_time() - before
        spent += len(population) * trials
        generation += 1
    seconds = time.process_time() - began
    chosen: list[tuple[float, str, Array]] = []
    for niche, candidates in search.finals.items():
        fitness = objective.on_trials(candidates, selection_seeds(seed, 100)).fitness
        chosen.append((float(fitness.max()), niche, candidates[int(fitness.argmax())]))
    _, niche, best = max(chosen, key=lambda one: one[0])
    achieved = objective.on_trials(best[None], trial_seeds(TEST_SEED, FRESH)).fitness[0]
    return Run(strategy, car, seed, spent, float(achieved), niche, seconds, asking / seconds)


def table(runs: list[Run], yardsticks: dict[int, float]) -> Table:
    """Return a row for each strategy on each car."""
    found = Table(title="achieved on the car itself, waypoints")
    for name in ("strategy", "car", "runs", "mean", "best", "reference", "reached", "s a run", "strategy share"):
        found.add_column(name, justify="left" if name == "strategy" else "right")
    for strategy in STRATEGIES:
        for car in sorted(yardsticks):
            own = [one for one in runs if (one.strategy, one.car) == (strategy, car)]
            if own:
                achieved = np.array([one.achieved for one in own])
                reached = int((achieved >= REACHED * yardsticks[car]).sum())
                found.add_row(
                    strategy, str(car), str(len(own)), f"{achieved.mean():.1f}", f"{achieved.max():.1f}",
                    f"{yardsticks[car]:.1f}", f"{reached} of {len(own)}",
                    f"{np.mean([one.seconds for one in own]):.0f}",
                    f"{100 * np.mean([one.bookkeeping for one in own]):.0f} %",
                )  # fmt: skip
    return found


def main(arguments: list[str] | None = None) -> int:
    """Make the runs that are missing and print the table."""
    parser = argparse.ArgumentParser(prog="tests.benchmarks.search", description=__doc__)
    parser.add_argument("--cars", default="0", help="emulated cars: 0 is the usual one, 1, 2, ... are perturbed")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--generations", type=int, default=1200)
    parser.add_argument("--strategies", default=",".join(STRATEGIES).replace(", ", "; "))
    parser.add_argument("--reference", type=float, default=0.0)
    parser.add_argument("--json", type=Path)
    add_markdown(parser)
    given = parser.parse_args(arguments)
    names = [name.replace("; ", ", ") for name in given.strategies.split(",")]
    stored = json.loads(given.json.read_text()) if given.json and given.json.is_file() else []
    runs = [Run(**one) for one in stored]
    known = {(one.strategy, one.car, one.seed) for one in runs}
    cars = [int(car) for car in given.cars.split(",")]
    console = Console(width=100)
    for car in cars:
        for seed in range(given.first_seed, given.first_seed + given.seeds):
            for strategy in names:
                if (strategy, car, seed) not in known:
                    runs.append(run(strategy, car, seed, given.generations))
                    console.print(f"{strategy}, car {car}, seed {seed}: {runs[-1].achieved:.2f} ({runs[-1].niche})")
                    if given.json:
                        given.json.write_text(json.dumps([asdict(one) for one in runs], indent=1))
    best = {car: max([given.reference, *(one.achieved for one in runs if one.car == car)]) for car in cars}
    print_tables([table(runs, best)], given.markdown, console)
    return 0


if __name__ == "__main__":
    sys.exit(main())
