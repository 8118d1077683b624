"""Time of rollouts with disturbances: ``python -m tests.benchmarks.disturbances``.

Each family is fitted to six minutes of the emulated car with the preset quick. Evolved controllers are rolled out in
the model alone and within each wrapper, in turn, compiled, on one thread: 1000 trials of 500 steps. Prints the
processor time (median of ``--repeats``) as a multiple of that of the model alone.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable

from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from evaluation.chosen_models import with_preset
from sysid_evo import make_model
from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.engine import rollout
from sysid_evo.models import Disturbed, DomainRandomisation, Dynamics
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import Spec
from sysid_evo.tasks import PointToPoint
from tests.benchmarks.cars import EMULATED, recording
from tests.benchmarks.markdown import add_markdown, print_tables
from tests.benchmarks.rollout import LATER, SEED, evolved
from tests.benchmarks.timing import in_turn

FAMILIES = ("parametrised", "sindy", "nearest_neighbour", "mlp_ensemble")
CANDIDATES, TRIALS, GENERATIONS = 50, 20, 20
ALONE = "alone"


def wrapped(model: Dynamics) -> dict[str, Dynamics]:
    """Return the model alone, and within each wrapper."""

    def noisy(**noise: float) -> Disturbed:
        return Disturbed(model, DomainRandomisation(**noise))

    return {
        ALONE: model,
        "nothing that disturbs": Disturbed(model),
        "a late state": Disturbed(model, delay=0.03),
        "`sensor=0.1`": noisy(sensor=0.1),
        "`gain=0.1`": noisy(gain=0.1),
        "`process=0.1`": noisy(process=0.1),
        "all of these": noisy(sensor=0.1, gain=0.1, process=0.1),
    }


def ratios(family: str, repeats: int, horizon: int) -> dict[str, float]:
    """Return the time of each wrapper around a family, as a multiple of that of the model alone."""
    model = make_model(with_preset(Spec.parse(family), "quick")).fit(recording(EMULATED)[0], rng=0)
    task, controller = PointToPoint(horizon=horizon), RecurrentNetwork()
    population = evolved(model, task, CANDIDATES, GENERATIONS)
    seeds = trial_seeds(SEED, TRIALS, generation=LATER)

    def program(dynamics: Dynamics) -> Callable[[], object]:
        return lambda: rollout(dynamics, controller, population, task, seeds, engine="float32", threads=1)

    programs = {name: program(dynamics) for name, dynamics in wrapped(model).items()}
    timings = in_turn(programs, repeats=repeats, shortest=0.03)
    return {name: timing.processor / timings[ALONE].processor for name, timing in timings.items() if name != ALONE}


def main(arguments: list[str] | None = None) -> int:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(prog="tests.benchmarks.disturbances", description=__doc__)
    parser.add_argument("--families", nargs="+", default=FAMILIES)
    parser.add_argument("--repeats", type=int, default=11)
    parser.add_argument("--horizon", type=int, default=500, help="steps of a trial (500)")
    add_markdown(parser)
    given = parser.parse_args(arguments)
    with threadpool_limits(1):
        found = [ratios(family, given.repeats, given.horizon) for family in given.families]
    table = Table("around the model", *(f"`{family}`" for family in given.families))
    for name in found[0]:
        table.add_row(name, *(f"{one[name]:.2f}" for one in found))
    print_tables([table], given.markdown, Console(width=110))
    return 0


if __name__ == "__main__":
    sys.exit(main())
