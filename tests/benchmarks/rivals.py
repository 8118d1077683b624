"""A co-evolved champion against one that was evolved alone: ``python -m tests.benchmarks.rivals``.

The emulated car is recorded and one of ``--model`` is fitted; in it two populations are evolved against each other for
``--generations``, and a controller alone, which sees no rival, for as many steps of bodies. Then they meet on the
car itself in ``--matches`` fresh races. Prints who wins what share of them, and what both achieve alone.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np
from rich.console import Console
from rich.table import Table

from hardware.robot import find_robot
from sysid_evo import ControllerEvolution, DynamicsRunner, evolve_controller, make_controller, make_model, make_task
from sysid_evo.evolution import Champion
from sysid_evo.evolution.controllers import selection_seeds
from sysid_evo.registry import Spec
from sysid_evo.rivals import evolve_rivals, match
from sysid_evo.rivals.coevolution import OPPONENTS


def main(arguments: list[str] | None = None) -> int:
    """Measure and print a line for each seed."""
    parser = argparse.ArgumentParser(prog="tests.benchmarks.rivals", description=__doc__)
    parser.add_argument("--model", default="sindy")
    parser.add_argument("--minutes", type=float, default=6.0)
    parser.add_argument("--task", default="duel")
    parser.add_argument("--generations", type=int, default=150)
    parser.add_argument("--trials", type=int, default=3)
    parser.add_argument("--matches", type=int, default=200)
    parser.add_argument("--seeds", type=int, default=2)
    given = parser.parse_args(arguments)
    robot, task = find_robot("emulated_car"), Spec.parse(given.task)
    track = Spec("walled_track", task.parameters)  # shows no rival
    car = robot.dynamics
    assert car is not None
    table = Table(title=f"{given.task} on the emulated car, {given.matches} races")
    for heading in ("seed", "rival wins", "lead, m", "rival alone, m", "evolved alone, m", "processor s"):
        table.add_column(heading, justify="right")
    for seed in range(given.seeds):
        began = time.process_time()
        data = robot.record(seed=seed, duration=60.0 * given.minutes).dataset
        runners = {given.model: DynamicsRunner(make_model(given.model).fit(data, rng=seed))}
        settings = ControllerEvolution(generations=given.generations, trials=given.trials, task=task)
        rivals = evolve_rivals("rival", runners, data.system, settings, seed=seed)
        settings = ControllerEvolution(generations=2 * given.generations, trials=given.trials * OPPONENTS, task=track)
        lonely = evolve_controller("alone", runners, data.system, settings, seed=seed)
        rival = max(rivals, key=lambda one: match(one, lonely, runners[given.model].dynamics, task=task, seed=seed).won)
        met = match(rival, lonely, car, task=task, trials=given.matches, seed=seed + 1)

        def way(champion: Champion, seed: int = seed) -> float:
            law, seeds = make_controller(champion.controller), selection_seeds(seed + 1, given.matches)
            run = DynamicsRunner(car).run(law, champion.parameters[None], make_task(champion.task), seeds)
            return float(run.fitness.mean())

        figures = (way(rival), way(lonely), time.process_time() - began)
        error = met.lead.std() / np.sqrt(len(met.lead))
        table.add_row(str(seed), f"{100.0 * met.won:.0f} %", f"{met.lead.mean():+.2f} ± {error:.2f}",
                      f"{figures[0]:.1f}", f"{figures[1]:.1f}", f"{figures[2]:.0f}")  # fmt: skip
    Console(width=100).print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
