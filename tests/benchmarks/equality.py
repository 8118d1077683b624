"""How often compiled rollouts score as the reference does: ``python -m tests.benchmarks.equality``.

For every registered family and emulated robot with a kernel: controllers are evolved on it, and the
last parents drive 1,000 rollouts of 500 steps in each form. The columns: mean waypoints of the
reference, share of equal scores, difference of the means, share of equal numbers of clipped steps.
A kernel that is exact enough in float64 alone is never run in float32, and not compared in it.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np
from rich.console import Console
from rich.table import Table

from evaluation.comparison.model_cells import with_preset
from hardware.robot import Robot
from sysid_evo.arrays import Array, Seeds
from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.data import Dataset
from sysid_evo.dynamics import Dynamics
from sysid_evo.engine import Engine, rollout
from sysid_evo.evolution.mu_plus_lambda import MuPlusLambda
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import Spec, make_model, make_robot, models, robots
from sysid_evo.tasks import PointToPoint
from tests.benchmarks.rollout.families import recording

FORMS: tuple[Engine, ...] = ("float64", "float32")


@dataclass(frozen=True)
class Agreement:
    """Mean waypoints of the reference, share of equal scores, difference of the means, same number of clipped steps."""

    mean: float
    equal: float
    difference: float
    clipped: float


def evolved_population(dynamics: Dynamics, generations: int, seed: int = 0, trials: int = 3) -> Array:
    """Return the last parents (50, 78) of a short evolution of the paper's controller on ``dynamics``."""
    strategy = MuPlusLambda(n_parameters=78, seed=seed)
    for generation in range(generations):
        population = strategy.ask()
        seeds = trial_seeds(seed, trials, generation=generation)
        run = rollout(dynamics, RecurrentNetwork(), population, PointToPoint(), seeds)
        strategy.tell(population, run.fitness.mean(axis=1))
    return strategy.elite


def agreement(dynamics: Dynamics, population: Array, seeds: Seeds, engine: Engine) -> Agreement:
    """Compare ``engine`` with the reference over every candidate in every trial."""
    given = (dynamics, RecurrentNetwork(), population, PointToPoint(), seeds)
    exact, fast = rollout(*given, engine="reference"), rollout(*given, engine=engine)
    return Agreement(
        float(exact.fitness.mean()),
        float((exact.fitness == fast.fitness).mean()),
        float(abs(exact.fitness.mean() - fast.fitness.mean())),
        float((exact.clipped == fast.clipped).mean()),
    )


def made(name: str, dataset: Dataset) -> Dynamics | None:
    """Return the registered robot's dynamics, or the registered family, quickly fitted."""
    if name in robots.names():
        robot: Robot = make_robot(name)
        return robot.dynamics
    return make_model(with_preset(Spec(name), "quick")).fit(dataset, rng=np.random.default_rng(0))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="families and robots; by default all that are registered")
    parser.add_argument("--generations", type=int, default=60)
    parser.add_argument("--trials", type=int, default=20, help="of each of the 50 last parents")
    arguments = parser.parse_args()
    dataset = recording(episodes=3, steps=220)
    table = Table("model", "form", "goals", "equal", "difference", "clipping")
    for name in arguments.names or [*models.names(), *robots.names()]:
        dynamics = made(name, dataset)
        kernel = None if dynamics is None else dynamics.kernel()
        if dynamics is None or kernel is None:
            continue
        population = evolved_population(dynamics, arguments.generations)
        seeds = trial_seeds(99, arguments.trials)
        for form in FORMS if kernel.precision == "float32" else FORMS[:1]:
            found = agreement(dynamics, population, seeds, form)
            table.add_row(
                name, form, f"{found.mean:.2f}", f"{found.equal:.2%}", f"{found.difference:.4f}", f"{found.clipped:.2%}"
            )
    Console().print(table)


if __name__ == "__main__":
    main()
