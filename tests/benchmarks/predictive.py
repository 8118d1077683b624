"""Predictive control compared with evolution in the same model: ``python -m tests.benchmarks.predictive --out FOLDER``.

The emulated car is recorded for ``--minutes`` and the ``--models`` are fitted in ``FOLDER`` (finished steps are not
repeated). Each model then controls the car in ``--trials`` fresh trials of `point_to_point`: inside the predictive
controller, and by a recurrent network evolved in it for ``--generations`` (0: none). The baseline controller is
pursuit. Prints waypoints and, for a single trial, the processor time of a decision in ms, in NumPy and compiled.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Self

import numpy as np
from rich.console import Console
from rich.table import Table

from evaluation import compare
from sysid_evo import (
    ControllerEvolution,
    DynamicsRunner,
    evolve_controller,
    load_model,
    make_controller,
    make_robot,
    make_task,
)
from sysid_evo.controllers import Controller, View
from sysid_evo.controllers.pursuit import Pursuit
from sysid_evo.engine import rollout
from sysid_evo.models import Dynamics
from sysid_evo.predictive_control import Engine, ImaginedTrials, Predictive
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import Spec
from sysid_evo.tasks import Task
from sysid_evo.types import Array
from tests.benchmarks.markdown import add_markdown, print_tables

MODELS = "sindy,mlp_ensemble,nearest_neighbour"
ENGINES: tuple[Engine, ...] = ("reference", "auto")
DECISIONS = 100
PERIOD = 50.0  # ms at 20 Hz


class Timed(Controller):
    """A bound controller that records the processor time of each decision in ms."""

    def __init__(self, bound: Controller) -> None:
        self.bound, self.spent = bound, list[float]()
        self.n_parameters, self.n_memory = bound.n_parameters, bound.n_memory

    def bind_to(self, task: Task) -> Self:
        return self

    def act(self, parameters: Array, memory: Array, view: View) -> tuple[Array, Array]:
        began = time.thread_time()
        acted = self.bound.act(parameters, memory, view)
        self.spent.append(1e3 * (time.thread_time() - began))
        return acted


def milliseconds(controller: Predictive, car: Dynamics, engine: Engine) -> list[float]:
    """Return the ms of processor time of each decision in one trial, the first left out."""
    task = make_task("point_to_point", horizon=DECISIONS)
    bound = controller.bind_to(task.bind(car.system))
    bound.imagined = tuple(ImaginedTrials(one.dynamics, one.task, engine=engine) for one in bound.imagined)
    timed = Timed(bound)
    rollout(car, timed, np.zeros((1, timed.n_parameters)), task, trial_seeds(0, 1), engine="reference")
    return timed.spent[1:]


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark from the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--models", default=MODELS)
    parser.add_argument("--minutes", type=float, default=6.0)
    parser.add_argument("--trials", type=int, default=30)
    parser.add_argument("--generations", type=int, default=300)
    add_markdown(parser)
    options = parser.parse_args(arguments)
    console = Console()
    names = options.models.split(",")
    compare(out=options.out, models=names, minutes=options.minutes, stop_after="fit")
    files = {name: next((options.out / "models").glob(f"{name}-*.json")) for name in names}
    car, task, seeds = make_robot("emulated_car").dynamics, make_task("point_to_point"), trial_seeds(5, options.trials)

    def achieved(controller: Controller, parameters: Array) -> tuple[str, str]:
        fitness = DynamicsRunner(car).bind(controller, task)(parameters[None], seeds).fitness[0]
        return f"{fitness.mean():.1f}", f"{fitness.std(ddof=1) / np.sqrt(len(fitness)):.1f}"

    table = Table(title=f"waypoints on the emulated car, {options.trials} trials")
    for heading in ("controller", "model", "achieved", "standard error", "ms, NumPy", "ms, compiled", "99 %"):
        table.add_column(heading, justify="left" if heading in ("controller", "model") else "right")
    inside = {**{name: str(file) for name, file in files.items()}, "the car itself": "emulated_car"}
    for name, model in inside.items():
        planning = Predictive(model=model)
        plain, spent = (milliseconds(planning, car, engine) for engine in ENGINES)
        row = (
            "predictive",
            name,
            *achieved(planning, np.zeros(2)),
            *(f"{np.percentile(times, q):.1f}" for times, q in ((plain, 50), (spent, 50), (spent, 99))),
        )
        console.print(*row)
        table.add_row(*row)
        if name in files and options.generations:
            runners = {name: DynamicsRunner(load_model(files[name]))}
            settings = ControllerEvolution(generations=options.generations, strategy=Spec("niches"))
            champion = evolve_controller(name, runners, car.system, settings, seed=0)
            table.add_row("evolved", name, *achieved(make_controller(champion.controller), champion.parameters))
    table.add_row("pursuit", "", *achieved(Pursuit(), np.zeros(4)))
    print_tables([table], options.markdown, console)
    console.print(f"20 Hz leaves {PERIOD:.0f} ms for a decision.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
