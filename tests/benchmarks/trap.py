"""Strategies on a fitness with two hills: ``python -m tests.benchmarks.trap [--seeds 20]``.

The broad hill has height 5, the steep one height 10 (`tests.fixtures.evolutions.trap`, three parameters); every fitness
has noise. A search succeeds if its best candidate is on the steep hill: fitness without noise above 5.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np
from rich.console import Console
from rich.table import Table

from sysid_evo.evolution import Scores, evolve
from sysid_evo.registry import Spec, strategies
from sysid_evo.types import Array
from tests.benchmarks.markdown import add_markdown, print_tables
from tests.fixtures.evolutions import CONTROLS, NAMES, trap

BROAD = 5.0
EVALUATIONS, POPULATION, NOISE = 4000, 20, 0.3
STRATEGIES = (
    f"niches(strategy=cma_es(population={POPULATION}, sigma=1))",
    f"cma_es(population={POPULATION}, sigma=1)",
    f"mu_plus_lambda(parents={POPULATION // 2}, children={POPULATION // 2})",
)


def found(name: str, seed: int) -> bool:
    """Return whether a search of `EVALUATIONS` by a strategy ends on the steep hill."""

    def noisy(population: Array, generation: int) -> Scores:
        nonlocal spent
        spent += len(population)
        scores = trap(population)
        rng = np.random.default_rng([seed, generation])
        return Scores(scores.fitness + NOISE * rng.standard_normal(len(population)), scores.behaviour)

    spent, generations = 0, EVALUATIONS // POPULATION
    search = strategies.make(Spec.parse(name), n_parameters=3, seed=seed)
    search.prepare(behaviour_names=NAMES, control_names=CONTROLS, generations=generations)
    for _ in evolve(search, noisy, generations):
        if spent >= EVALUATIONS:
            break
    return float(trap(search.elite[:1]).fitness[0]) > BROAD


def main(arguments: list[str] | None = None) -> int:
    """Search with all strategies and seeds, and print the table."""
    parser = argparse.ArgumentParser(prog="tests.benchmarks.trap", description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    add_markdown(parser)
    given = parser.parse_args(arguments)
    table = Table("strategy", "steep hill found")
    for name in STRATEGIES:
        table.add_row(f"`{name}`", f"{sum(found(name, seed) for seed in range(given.seeds))} of {given.seeds}")
    print_tables([table], given.markdown, Console(width=120))
    return 0


if __name__ == "__main__":
    sys.exit(main())
