"""CMA-ES of this project compared with the library ``cma``: ``python -m tests.benchmarks.cma functions|speed``.

``functions``: evaluations until a target is reached, or the best value after a budget if the target is not reached, on
four functions in 10, 40 and 170 dimensions. Both start at the same point with the same population and sigma; other
settings of ``cma`` are its defaults. Prints medians, their ratio, and the p-value of a two-sided rank test (Mann and
Whitney). ``--json FILE`` stores all runs; a stored run is not repeated.

``speed``: processor time in ms of `ask` and `tell`, measured in alternating blocks of generations.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import cma
import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.stats import mannwhitneyu
from threadpoolctl import threadpool_limits

from sysid_evo.evolution.strategies.cma_es import CmaEs
from sysid_evo.types import Array

OURS, LIBRARY = "ours", "cma"


def sphere(x: Array) -> Array:
    return (x**2).sum(axis=1)


def ellipsoid(x: Array) -> Array:
    """Axes of lengths 1 to 1,000."""
    return (1e6 ** np.linspace(0.0, 1.0, x.shape[1]) * x**2).sum(axis=1)


def rosenbrock(x: Array) -> Array:
    return (100.0 * (x[:, 1:] - x[:, :-1] ** 2) ** 2 + (1.0 - x[:, :-1]) ** 2).sum(axis=1)


def rastrigin(x: Array) -> Array:
    return (10.0 + x**2 - 10.0 * np.cos(2.0 * np.pi * x)).sum(axis=1)


@dataclass(frozen=True)
class Case:
    """A function to minimise from ``start`` in every coordinate, in at most ``generations``.

    Without a ``target`` the best value that was reached counts, otherwise the evaluations.
    """

    function: Callable[[Array], Array]
    n: int
    population: int
    sigma: float
    start: float
    generations: int
    target: float | None = None

    @property
    def name(self) -> str:
        return f"{self.function.__name__} {self.n}"

    @property
    def counted(self) -> str:
        """Description of the comparison."""
        if self.target is None:
            return f"best after {self.generations * self.population:,}"
        return f"evaluations to {self.target:g}"


CASES = (
    Case(sphere, 10, 10, 1.0, 3.0, 1000, 1e-8),
    Case(sphere, 40, 15, 1.0, 3.0, 1000, 1e-8),
    Case(sphere, 170, 50, 1.0, 3.0, 2000, 1e-2),
    Case(ellipsoid, 10, 10, 1.0, 3.0, 2000, 1e-8),
    Case(ellipsoid, 40, 30, 1.0, 3.0, 3000, 1e-8),
    Case(ellipsoid, 170, 50, 1.0, 3.0, 400),
    Case(rosenbrock, 10, 10, 0.5, 0.0, 2000, 1e-8),
    Case(rosenbrock, 40, 30, 0.5, 0.0, 3000, 1e-8),
    Case(rosenbrock, 170, 50, 0.5, 0.0, 400),
    Case(rastrigin, 10, 200, 3.0, 3.0, 1000, 1e-8),
    Case(rastrigin, 40, 200, 3.0, 3.0, 600),
    Case(rastrigin, 170, 300, 3.0, 3.0, 200),
)


@dataclass(frozen=True)
class Run:
    """One search: evaluations until the target (None if it was not reached), and the best value."""

    case: str
    who: str
    seed: int
    evaluations: int | None
    best: float
    seconds: float

    def counted(self, case: Case) -> float:
        """Return the figure that is compared."""
        if case.target is None:
            return self.best
        return np.inf if self.evaluations is None else self.evaluations


class Library:
    """The library with the same questions and answers."""

    def __init__(self, n: int, population: int, sigma: float, start: float, seed: int) -> None:
        options = {"popsize": population, "seed": seed + 1, "verbose": -9}  # its seed 0 is the clock
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            self.search = cma.CMAEvolutionStrategy(np.full(n, start), sigma, options)

    def ask(self) -> Array:
        return np.array(self.search.ask())

    def tell(self, asked: Array, costs: Array) -> None:
        self.search.tell(list(asked), costs.tolist())


class Own:
    """The strategy of the project, without its mean among the candidates, and with costs instead of fitness."""

    def __init__(self, n: int, population: int, sigma: float, start: float, seed: int) -> None:
        initial = np.full(n, start)
        self.search = CmaEs(n_parameters=n, seed=seed, population=population, sigma=sigma, initial=initial)

    def ask(self) -> Array:
        self.population = self.search.ask()
        return self.population[:-1]

    def tell(self, asked: Array, costs: Array) -> None:
        self.search.tell(self.population, np.append(-costs, -np.inf))


KINDS: dict[str, type[Own | Library]] = {OURS: Own, LIBRARY: Library}


def searched(case: Case, who: str, seed: int) -> Run:
    """Search until the target is reached or the budget is spent."""
    began, best = time.process_time(), np.inf
    search = KINDS[who](case.n, case.population, case.sigma, case.start, seed)
    for generation in range(1, case.generations + 1):
        asked = search.ask()
        costs = case.function(asked)
        best = min(best, float(costs.min()))
        if case.target is not None and best <= case.target:
            evaluations = generation * case.population
            return Run(case.name, who, seed, evaluations, best, time.process_time() - began)
        search.tell(asked, costs)
    return Run(case.name, who, seed, None, best, time.process_time() - began)


def functions(seeds: int, file: Path | None) -> Table:
    """Make the runs that are missing and return a row for each case."""
    runs = [Run(**one) for one in json.loads(file.read_text())] if file is not None and file.is_file() else []
    known = {(run.case, run.who, run.seed) for run in runs}
    for case, seed in itertools.product(CASES, range(seeds)):
        runs += [searched(case, who, seed) for who in KINDS if (case.name, who, seed) not in known]
        if file is not None:
            file.write_text(json.dumps([asdict(run) for run in runs], indent=1))
    table = Table(title=f"{seeds} seeds")
    for name in ("case", "population", "compared", "median, ours", "median, cma", "ratio", "p", "s, ours", "s, cma"):
        table.add_column(name, justify="left" if name in ("case", "compared") else "right")
    for case in CASES:
        made = {
            who: [run for run in runs if (run.case, run.who) == (case.name, who) and run.seed < seeds] for who in KINDS
        }
        values = {who: np.array([run.counted(case) for run in own]) for who, own in made.items()}
        medians = {who: float(np.median(found)) for who, found in values.items()}
        missed = {who: int(np.isinf(found).sum()) for who, found in values.items()}
        table.add_row(
            case.name, str(case.population), case.counted,
            *(f"{medians[who]:,.4g}" + (f" ({missed[who]} missed)" if missed[who] else "") for who in KINDS),
            f"{medians[OURS] / medians[LIBRARY]:.3f}",
            f"{mannwhitneyu(values[OURS], values[LIBRARY], alternative='two-sided').pvalue:.3f}",
            *(f"{sum(run.seconds for run in own):.0f}" for own in made.values()),
        )  # fmt: skip
    return table


def speed(n: int, population: int, blocks: int, generations: int) -> Table:
    """Return milliseconds per generation, and their ratio in neighbouring blocks."""
    luck = np.random.default_rng(0)
    searches = {who: kind(n, population, 3.0, 0.0, 1) for who, kind in KINDS.items()}
    taken: dict[str, list[float]] = {who: [] for who in KINDS}
    for block in range(blocks + 1):
        for who, search in searches.items():
            costs = luck.standard_normal((generations, population))
            began = time.process_time()
            for cost in costs:
                search.tell(search.ask(), cost)
            if block:  # the first one is not counted
                taken[who].append(1e3 * (time.process_time() - began) / generations)
    table = Table(title=f"{n} parameters, {population} candidates, {blocks} blocks of {generations} generations")
    for name in ("", "median", "quartiles"):
        table.add_column(name, justify="right" if name else "left")
    ratios = np.array(taken[LIBRARY]) / np.array(taken[OURS])
    for name, values in ((f"ms, {OURS}", taken[OURS]), (f"ms, {LIBRARY}", taken[LIBRARY]), ("ratio", ratios)):
        low, middle, high = np.quantile(values, [0.25, 0.5, 0.75])
        table.add_row(name, f"{middle:.2f}", f"{low:.2f} to {high:.2f}")
    return table


def main(arguments: list[str] | None = None) -> int:
    """Run one of the commands and print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    of_functions, of_speed = (commands.add_parser(name) for name in ("functions", "speed"))
    of_functions.add_argument("--seeds", type=int, default=20)
    of_functions.add_argument("--json", type=Path)
    of_speed.add_argument("--parameters", type=int, default=78)
    of_speed.add_argument("--population", type=int, default=50)
    of_speed.add_argument("--blocks", type=int, default=20)
    of_speed.add_argument("--generations", type=int, default=50, help="in a block (50)")
    given = parser.parse_args(arguments)
    with threadpool_limits(1):
        if given.command == "functions":
            table = functions(given.seeds, given.json)
        else:
            table = speed(given.parameters, given.population, given.blocks, given.generations)
    Console(width=130).print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
