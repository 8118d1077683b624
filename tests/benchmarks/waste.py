"""What evolution does not compute because it cannot matter: ``python -m tests.benchmarks.waste [--run FOLDER]``.

Two controllers are evolved in each ensemble from the same seed, in turn: one where every candidate is run on every
model, one where candidates that cannot become one of the best are spared the dear models. Printed are the rollouts
asked for and made, the share made on each model, processor time of both (the least of ``--repeats``), and whether
parents, champion and the best of every generation are the same, bit by bit. A second table is what a generation takes
around the rollouts themselves: asking and telling of each strategy, and a rollout of one step.

The models are those of the run folder of a comparison, or by default three that are fitted in seconds, to two minutes
of the emulated car.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from hardware.recording.scripted import record_dataset
from sysid_evo import load_model
from sysid_evo.arrays import Array, Seeds
from sysid_evo.controllers import Controller
from sysid_evo.dynamics import Dynamics
from sysid_evo.engine import DynamicsRunner, Rollouts, rollout
from sysid_evo.evolution import EnsembleObjective, EvolutionStrategy, Objective, evolve
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import make_controller, make_model, make_robot, make_strategy, make_task
from sysid_evo.tasks import Task

FITTED = ("linear", "backprop27", "nearest_neighbour")
PAPER = ("evolved3+nearest_neighbour", "backprop27+nearest_neighbour+parametrised")
STRATEGY, TRIALS = "mu_plus_lambda", 10
RECORDED_TIME = 120.0
AROUND = ("mu_plus_lambda", "cma_es", "niches", "map_elites")
WARM = 3


@dataclass
class Counting:
    """A runner that counts its rollouts."""

    dynamics: Dynamics
    rollouts: int = 0

    def run(
        self, controller: Controller, parameters: Array, task: Task, seeds: Seeds, *, record: bool = False
    ) -> Rollouts:
        """Run every candidate, on one thread."""
        self.rollouts += len(parameters) * len(seeds)
        return DynamicsRunner(self.dynamics, threads=1).run(controller, parameters, task, seeds, record=record)


@dataclass(frozen=True)
class Search:
    """One evolution: rollouts on each model, processor seconds, and where it went."""

    rollouts: tuple[int, ...]
    seconds: float
    way: tuple[bytes, ...]


def searched(
    members: Sequence[Dynamics], strategy: str, aggregate: str, generations: int, seed: int, *, spare: bool
) -> Search:
    """Evolve on all of ``members`` at once."""
    task = make_task("point_to_point").bind(members[0].system)
    controller = make_controller("recurrent").bind_to(task)
    runners = [Counting(member) for member in members]
    objective = EnsembleObjective(runners, controller, task, seed, TRIALS, aggregate)
    everyone: Objective = objective if spare else lambda population, index: objective(population, index)
    search = make_strategy(strategy, n_parameters=controller.n_parameters, seed=seed)
    for _ in evolve(search, everyone, WARM):
        pass
    for runner in runners:
        runner.rollouts = 0
    began = time.process_time()
    best = [generation.summary[0] for generation in evolve(search, everyone, generations + WARM, start=WARM)]
    seconds = time.process_time() - began
    way = np.array(best).tobytes(), search.elite.tobytes()
    return Search(tuple(runner.rollouts for runner in runners), seconds, way)


def spared(models: Mapping[str, Dynamics], ensembles: Sequence[str], arguments: argparse.Namespace) -> Table:
    """Return a row for each ensemble and aggregate."""
    found = Table(title=f"rollouts of {arguments.generations} generations, {arguments.strategy}")
    for name in ("ensemble", "rule", "asked", "made", "of each", "s, all", "s, spared", "same"):
        found.add_column(name, justify="left" if name in ("ensemble", "rule", "of each") else "right")
    for ensemble in ensembles:
        members = ensemble.split("+")
        for aggregate in arguments.aggregates:
            runs: dict[bool, list[Search]] = {False: [], True: []}
            for _ in range(arguments.repeats):
                for spare, searches in runs.items():
                    searches.append(
                        searched(
                            [models[member] for member in members],
                            arguments.strategy, aggregate, arguments.generations, arguments.seed, spare=spare,
                        )
                    )  # fmt: skip
            asked, made = runs[False][0].rollouts, runs[True][0].rollouts
            found.add_row(
                "\n".join(members), aggregate, f"{sum(asked):,}", f"{sum(made):,}",
                "\n".join(f"{100 * part / whole:.0f} %" for part, whole in zip(made, asked, strict=True)),
                *(f"{min(one.seconds for one in searches):.2f}" for searches in runs.values()),
                "yes" if len({one.way for searches in runs.values() for one in searches}) == 1 else "NO",
            )  # fmt: skip
    return found


def around(dynamics: Dynamics, repeats: int) -> Table:
    """Return the milliseconds that a generation takes around the rollouts themselves."""
    found = Table(title="around the rollouts, ms a generation")
    found.add_column("what")
    found.add_column("ms", justify="right")
    task = make_task("point_to_point").bind(dynamics.system)
    controller = make_controller("recurrent(hidden=10)").bind_to(task)
    for strategy in AROUND:
        search = make_strategy(strategy, n_parameters=controller.n_parameters, seed=1)
        found.add_row(f"asking and telling {strategy}", f"{_usual(partial(_cycle, search), 20 * repeats):.2f}")
    brief = make_task("point_to_point(horizon=1)").bind(dynamics.system)
    population = np.random.default_rng(0).standard_normal((100, controller.n_parameters))
    for name, bound in (("of one step", brief), ("of 500 steps", task)):

        def rolled(k: int, bound: Task = bound) -> None:
            rollout(dynamics, controller, population, bound, trial_seeds(1, 5, generation=k), threads=1)

        found.add_row(f"500 rollouts {name}", f"{_usual(rolled, 20 * repeats):.2f}")
    return found


def _cycle(search: EvolutionStrategy, _: int) -> None:
    population = search.ask()
    search.tell(population, -np.abs(population).sum(axis=1))


def _usual(program: Callable[[int], object], repeats: int) -> float:
    taken = []
    for k in range(repeats):
        began = time.process_time()
        program(k)
        taken.append(time.process_time() - began)
    return 1e3 * float(np.median(taken))


def models_of(run: Path | None) -> dict[str, Dynamics]:
    """Return the models of a run folder by family, or those of `FITTED`."""
    if run is not None:
        return {file.name.rpartition("-")[0]: load_model(file) for file in sorted((run / "models").glob("*.json"))}
    data = record_dataset(make_robot("emulated_car"), seed=0, duration=RECORDED_TIME).dataset
    return {name: make_model(name).fit(data, rng=np.random.default_rng(0)) for name in FITTED}


def main(arguments: Sequence[str] | None = None) -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", type=Path, help="run folder of a comparison whose models are taken")
    parser.add_argument("--ensembles", nargs="+", help="labels joined by +; the paper's two, or all that were fitted")
    parser.add_argument("--strategy", default=STRATEGY)
    parser.add_argument("--aggregates", nargs="+", default=["min"])
    parser.add_argument("--generations", type=int, default=100)
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args(arguments)
    models = models_of(given.run)
    there = [one for one in PAPER if set(one.split("+")) <= set(models)]
    console = Console(width=80)
    console.print(spared(models, given.ensembles or there or ["+".join(FITTED)], given))
    console.print(around(next(iter(models.values())), given.repeats))


if __name__ == "__main__":
    main()
