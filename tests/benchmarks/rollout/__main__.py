"""How fast rollouts are: ``python -m tests.benchmarks.rollout``.

For each model, a population of evolved controllers is rolled out by the fast engine on one and two
threads, by the NumPy reference and, where there is a form, by plain JAX (compiled beforehand), in
turn and in one process. Speeds and ratios are medians of processor time, which other processes
disturb least; only the two threads are compared on the clock. Ends with a generation of evosax.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from threadpoolctl import threadpool_limits

from sysid_evo.arrays import Array
from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.dynamics import Dynamics
from sysid_evo.engine import DynamicsRunner, rollout
from sysid_evo.evolution import EnsembleObjective, MuPlusLambda, evolve
from sysid_evo.randomness import trial_seeds
from sysid_evo.tasks import PointToPoint
from tests.benchmarks.rollout.families import Case, cases, recording
from tests.benchmarks.rollout.table import speeds
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


def measure(case: Case, task: PointToPoint, population: Array, repeats: int, jax: bool) -> dict[str, Any]:
    """Return one row: speeds in million steps per second, and their ratios."""
    dynamics, controller = case.dynamics, RecurrentNetwork()
    seeds = trial_seeds(SEED, TRIALS, generation=LATER)

    def fast(threads: int) -> Array:
        return rollout(dynamics, controller, population, task, seeds, engine="float32", threads=threads).fitness

    programs: dict[str, Callable[[], object]] = {
        "one_thread": lambda: fast(1),
        "two_threads": lambda: fast(2),
        "numpy": lambda: rollout(dynamics, controller, population, task, seeds, engine="reference"),
    }
    if jax:
        from tests.benchmarks.rollout import jax_forms

        program = jax_forms.rollouts(dynamics, task, population, seeds)
        if program is not None:
            programs["jax"] = program
    timings = in_turn(programs, repeats=repeats, shortest=0.03)
    steps = population.shape[0] * TRIALS * task.horizon / 1e6
    one, two = timings["one_thread"], timings["two_threads"]
    row: dict[str, Any] = {
        "model": case.name,
        "mean_fitness": float(fast(1).mean()),
        "million_steps_per_second": {
            name: steps / (timing.wall if name == "two_threads" else timing.processor)
            for name, timing in timings.items()
        },
        "seconds": {name: {"processor": t.processor, "wall": t.wall} for name, t in timings.items()},
        "ratio_to_numpy": timings["numpy"].processor / one.processor,
        "ratio_of_two_threads": one.wall / two.wall,
    }
    if "jax" in timings:
        row["ratio_to_jax"] = timings["jax"].processor / one.processor
        row["mean_fitness_jax"] = float(np.mean(programs["jax"]()))  # type: ignore[arg-type]  # an array
    return row


def measure_generation(case: Case, task: PointToPoint, population: Array, repeats: int) -> dict[str, float]:
    """Return the milliseconds that one generation takes with evosax in JAX, and here."""
    from tests.benchmarks.rollout import jax_forms

    strategy = MuPlusLambda(n_parameters=N_PARAMETERS, seed=SEED, parents=len(population) // 2,
                            children=len(population) - len(population) // 2)  # fmt: skip
    objective = EnsembleObjective((DynamicsRunner(case.dynamics, threads=1),), RecurrentNetwork(), task, SEED, TRIALS)
    theirs = jax_forms.generation(case.dynamics, task, population, trial_seeds(SEED, TRIALS))
    assert theirs is not None
    programs = {"here": lambda: next(evolve(strategy, objective, 1)), "evosax": theirs}
    timings = in_turn(programs, repeats=repeats, shortest=0.03)
    return {name: 1e3 * timing.processor for name, timing in timings.items()}


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, print the table, perhaps write JSON."""
    parser = argparse.ArgumentParser(prog="tests.benchmarks.rollout", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="small populations and one repeat: does it run?")
    parser.add_argument("--without-jax", action="store_true", help="leave out JAX and evosax")
    parser.add_argument("--models", nargs="*", default=[], help="only models whose names contain one of these")
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    chosen = parser.parse_args(arguments)
    jax = not chosen.without_jax and importlib.util.find_spec("jax") is not None
    candidates, generations, repeats = (10, 2, 1) if chosen.quick else (100, 60, chosen.repeats)
    task = PointToPoint(horizon=50 if chosen.quick else 500)
    load = os.getloadavg()[0]
    console, rows, report = Console(), [], {}
    dataset = recording(episodes=2 if chosen.quick else 12, steps=600)
    with threadpool_limits(1):
        for case in cases(dataset, generations=5 if chosen.quick else 60):
            if chosen.models and not any(part in case.name for part in chosen.models):
                continue
            population = evolved(case.dynamics, task, candidates, generations)
            rows.append(measure(case, task, population, repeats, jax))
            if jax and not report and "jax" in rows[-1]["seconds"] and importlib.util.find_spec("evosax") is not None:
                report = {"model": case.name, **measure_generation(case, task, population, repeats)}
    console.print(speeds(rows))
    console.print(
        "goals: mean fitness; thr.: threads. Processor time, but 2 thr. and 2/1 by the clock; "
        f"load average at the start {load:.1f} on {os.cpu_count()} processors."
    )
    if not jax and not chosen.without_jax:
        console.print(
            "JAX is not installed and was left out; install the peers with: pip install '.[bench]'", markup=False
        )
    if report:
        console.print(
            f"A generation on {report['model']}: evosax in JAX {report['evosax']:.1f} ms, "
            f"here {report['here']:.1f} ms, {report['evosax'] / report['here']:.1f} times as fast."
        )
    if chosen.json is not None:
        chosen.json.write_text(json.dumps({"load": load, "models": rows, "generation": report}, indent=1))


if __name__ == "__main__":
    main()
