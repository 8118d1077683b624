"""Fitness of controllers without evolution on emulated robots: ``python -m tests.benchmarks.baselines``.

Each controller has zeros as its parameters; those with a model inside have the robot's own equations. Prints mean and
standard error over fresh trials.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np
from rich.console import Console
from rich.table import Table

from sysid_evo import make_controller, make_task
from sysid_evo.engine import DynamicsRunner
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import make_robot
from tests.benchmarks.markdown import add_markdown, print_tables

SEED = 9
CASES = (
    ("lqr(model=pendulum)", "pendulum", "balance", 100),
    ("lqr(model=cart_pole)", "cart_pole", "balance", 100),
    ("pursuit", "emulated_car", "point_to_point", 300),
    ("pursuit(backward=true)", "emulated_car", "point_to_point", 300),
    ("predictive(model=emulated_car)", "emulated_car", "walled_track", 12),
    ("predictive(model=emulated_car, horizon=12)", "emulated_car", "walled_track", 12),
)
"""Controller, robot, task, trials."""


def fitness(controller: str, robot: str, task: str, trials: int) -> tuple[float, float, str]:
    """Return mean fitness, its standard error, and the unit."""
    goal = make_task(task)
    runner = DynamicsRunner(make_robot(robot).dynamics).bind(make_controller(controller), goal)
    found = runner(np.zeros((1, runner.controller.n_parameters)), trial_seeds(SEED, trials)).fitness.ravel()
    return float(found.mean()), float(found.std(ddof=1) / np.sqrt(trials)), goal.fitness_unit


def main(arguments: list[str] | None = None) -> int:
    """Run all controllers and print the table."""
    parser = argparse.ArgumentParser(prog="tests.benchmarks.baselines", description=__doc__)
    parser.add_argument("--only", default="", help="only controllers with this in their name")
    add_markdown(parser)
    given = parser.parse_args(arguments)
    table = Table("controller", "robot", "task", "trials", "fitness", "unit")
    for controller, robot, task, trials in CASES:
        if given.only in controller:
            mean, error, unit = fitness(controller, robot, task, trials)
            table.add_row(f"`{controller}`", f"`{robot}`", f"`{task}`", str(trials), f"{mean:.1f} ± {error:.1f}", unit)
    print_tables([table], given.markdown, Console(width=120))
    return 0


if __name__ == "__main__":
    sys.exit(main())
