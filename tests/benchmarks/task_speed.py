"""Speed of rollouts at each task, on the same model: ``python -m tests.benchmarks.task_speed``.

For each of ``--tasks`` a population is evolved for a few generations on the `parametrised` family and on the emulated
car, and then rolled out on one thread by the compiled engine, all tasks in turn in one process. Prints million steps
per second of processor time, and the speed of each task relative to the first.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping

import numpy as np
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from model_zoo.car.parametrised import Parametrised
from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.engine import DynamicsRunner, rollout
from sysid_evo.evolution import evolve
from sysid_evo.evolution.controller_evolution import EnsembleObjective
from sysid_evo.evolution.strategies.mu_plus_lambda import MuPlusLambda
from sysid_evo.models import Dynamics
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import Spec, make_robot
from sysid_evo.tasks import Task
from sysid_evo.tasks.task import make_task
from tests.benchmarks.rollout import recording
from tests.benchmarks.timing import in_turn

TASKS = "point_to_point, walled_track, sideways=walled_track(rays=9, view=6.2)"
TRIALS = 10
LATER = 10_000  # a generation that evolution does not reach: fresh trials


def program(dynamics: Dynamics, task: Task, candidates: int, generations: int) -> Callable[[], object]:
    """Return the rollouts of a population that was evolved for ``generations`` at ``task``."""
    controller = RecurrentNetwork()
    strategy = MuPlusLambda(
        n_parameters=controller.bind_to(task.bind(dynamics.system)).n_parameters,
        seed=1,
        parents=candidates // 2,
        children=candidates // 2,
    )
    objective = EnsembleObjective((DynamicsRunner(dynamics, threads=1),), controller, task, 1, TRIALS)
    for _ in evolve(strategy, objective, generations):
        pass
    population, seeds = strategy.ask(), trial_seeds(1, TRIALS, generation=LATER)
    return lambda: rollout(dynamics, controller, population, task, seeds, engine="float32", threads=1)


def models(quick: bool) -> Mapping[str, Dynamics]:
    """Return the fastest of the families, and the emulated car with its delays and finer steps."""
    data = recording(episodes=2 if quick else 12, steps=600)
    fast = Parametrised(generations=5 if quick else 60).fit(data, rng=np.random.default_rng(0))
    return {"parametrised": fast, "emulated_car": make_robot("emulated_car").dynamics}


def main(arguments: list[str] | None = None) -> int:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(prog="tests.benchmarks.task_speed", description=__doc__)
    parser.add_argument("--tasks", default=TASKS)
    parser.add_argument("--generations", type=int, default=60)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--quick", action="store_true", help="small populations and one repeat: does it run?")
    given = parser.parse_args(arguments)
    candidates, generations, repeats = (10, 2, 1) if given.quick else (100, given.generations, given.repeats)
    chosen = {spec.label: make_task(spec) for spec in Spec.parse_many(given.tasks)}
    table = Table(title="Million environment steps per second, one thread")
    for heading in ("model", "task", "speed", f"of {next(iter(chosen))}"):
        table.add_column(heading, justify="left" if heading in ("model", "task") else "right")
    with threadpool_limits(1):
        for name, dynamics in models(given.quick).items():
            programs = {label: program(dynamics, task, candidates, generations) for label, task in chosen.items()}
            timings = in_turn(programs, repeats=repeats, shortest=0.03)
            speeds = {
                label: candidates * TRIALS * chosen[label].horizon / 1e6 / timing.processor
                for label, timing in timings.items()
            }
            first = next(iter(speeds.values()))
            for label, speed in speeds.items():
                table.add_row(name, label, f"{speed:.1f}", f"{speed / first:.2f}")
    Console(width=100).print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
