"""Rollouts in regressors, compiled, against `predict`: ``python -m tests.benchmarks.regressors``.

Models of the family `regressor` are fitted to a recording of the emulated car. The same controllers are rolled out in
turn in one process: compiled, by `predict` for all rollouts of a step together, and by `predict` for one rollout after
the other, which is what a program does that simulates step by step. Times are processor time of one thread. With
``--generations 300`` a controller is evolved in each model, too, on all processors.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.engine import rollout
from sysid_evo.evolution import ControllerEvolution, evolve_controller
from sysid_evo.models import DynamicsModel
from sysid_evo.models.base import make_model
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import Spec, make_robot
from sysid_evo.tasks import PointToPoint
from tests.benchmarks.markdown import add_markdown, print_tables
from tests.benchmarks.timing import in_turn

MODELS = (
    "forest=regressor(estimator=RandomForestRegressor, n_estimators=100, max_depth=10), "
    "histograms=regressor(estimator=HistGradientBoostingRegressor), "
    "network=regressor(estimator=MLPRegressor), ridge=regressor(estimator=Ridge)"
)
CANDIDATES, TRIALS = 50, 10


def measure(model: DynamicsModel, horizon: int, repeats: int) -> dict[str, float]:
    """Return the processor time of a step of one rollout in µs, in three forms."""
    controller, task = RecurrentNetwork(), PointToPoint(horizon=horizon)
    seeds, rng = trial_seeds(1, TRIALS), np.random.default_rng(0)
    n_parameters = controller.bind_to(task.bind(model.system)).n_parameters
    population = rng.standard_normal((CANDIDATES, n_parameters))

    def run(engine: Any, candidates: int, trials: int, **settings: Any) -> Any:
        return rollout(model, controller, population[:candidates], task, seeds[:trials], engine=engine, **settings)

    programs: dict[str, tuple[Callable[[], object], int]] = {
        "compiled": (lambda: run("float32", CANDIDATES, TRIALS, threads=1), CANDIDATES * TRIALS),
        "together": (lambda: run("reference", CANDIDATES, TRIALS), CANDIDATES * TRIALS),
        "one_by_one": (lambda: run("reference", 1, 1), 1),
    }
    timings = in_turn({name: program for name, (program, _) in programs.items()}, repeats=repeats, shortest=0.05)
    return {name: 1e6 * timings[name].processor / (count * horizon) for name, (_, count) in programs.items()}


def evolve(model: DynamicsModel, generations: int) -> tuple[float, float]:
    """Return the seconds of an evolution in ``model``, by the clock and of all processors."""
    settings = ControllerEvolution(generations=generations, trials=5, strategy=Spec.parse("niches"))
    wall, processor = time.perf_counter(), time.process_time()
    evolve_controller("champion", {"model": model}, model.system, settings, seed=0)
    return time.perf_counter() - wall, time.process_time() - processor


def main(arguments: Sequence[str] | None = None) -> None:
    """Fit, measure, print the table."""
    parser = argparse.ArgumentParser(prog="tests.benchmarks.regressors", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a short recording and few steps: does it run?")
    parser.add_argument("--models", default=MODELS)
    parser.add_argument("--generations", type=int, default=0)
    parser.add_argument("--repeats", type=int, default=3)
    add_markdown(parser)
    chosen = parser.parse_args(arguments)
    load, console = os.getloadavg()[0], Console()
    dataset = make_robot("emulated_car").record(seed=0, duration=30.0 if chosen.quick else 360.0).dataset
    table = Table(title="µs a step of one rollout", box=SIMPLE_HEAD, padding=(0, 1), collapse_padding=True)
    for column in ("model", "compiled", "together", "one by one", "ratio", "to one", "s", "cpu s"):
        table.add_column(column, justify="left" if column == "model" else "right", no_wrap=True)
    for spec in Spec.parse_many(chosen.models):
        model = make_model(spec, state_lags=0, control_lags=0).fit(dataset, rng=0)
        with threadpool_limits(1):
            found = measure(model, 20 if chosen.quick else 100, 1 if chosen.quick else chosen.repeats)
        row = [f"{found[name]:.3g}" for name in ("compiled", "together", "one_by_one")]
        row += [f"{found[name] / found['compiled']:.0f}" for name in ("together", "one_by_one")]
        seconds = evolve(model, chosen.generations) if chosen.generations else ()
        table.add_row(spec.label, *row, *(f"{one:.0f}" for one in seconds))
    print_tables([table], chosen.markdown, console)
    console.print(
        f"together, one by one: `predict` for {CANDIDATES * TRIALS} rollouts and for one. ratio, to one: to these. "
        f"s, cpu s: {chosen.generations} generations. Load at the start {load:.1f} on {os.cpu_count()} processors."
    )


if __name__ == "__main__":
    main()
