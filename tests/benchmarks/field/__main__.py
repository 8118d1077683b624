"""Tools of the field on one bench: ``python -m tests.benchmarks.field --out FOLDER --seeds 3``.

Every package is fitted to the same recordings, a controller is evolved in each model, and run on the emulated robot, or
on the other models where there is none. A table for each system has the simulation error N (RMSE in standard deviations
of the recording) at four horizons and over whole episodes, the seconds of a fit and of a million steps, the fitness of
the controller, the share of its claim that it keeps, and whether the claim is exploited: means over seeds, with half
the distance of the lowest and the highest. The recordings are those of `tests.benchmarks.cars`, in
``$SYSID_EVO_DATA``. Finished steps in FOLDER are not repeated. The extra ``field`` has the packages, the file
``constraints.txt`` here their versions.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from evaluation import compare
from evaluation.planning import comparison_of
from evaluation.results import ComparisonResults
from evaluation.transfer.summary import is_exploited
from sysid_evo.controllers.controller import make_controller
from sysid_evo.engine import rollout
from sysid_evo.models import DynamicsModel
from sysid_evo.plan import Store
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import Spec
from sysid_evo.tasks.task import make_task
from tests.benchmarks.cars import TEST_EPISODE, recording
from tests.benchmarks.markdown import add_markdown, print_tables

SYSTEMS = ("slippery_20hz", "free_20hz", "emulated_car", "cart_pole", "thermal")
PLUGIN = Path(__file__).with_name("peers.py")


def pysindy_default() -> Any:
    """Return the model of pysindy's introduction: quadratic polynomials, STLSQ, finite differences."""
    import pysindy

    return pysindy.SINDy()


MODELS: Mapping[str, str | Callable[[], Any]] = {
    "pysindy": pysindy_default,
    "sysidentpy": "sysidentpy_frols",
    "sysidentpy_narx": "sysidentpy_narx",
    "nfoursid": "nfoursid",
    "pydmd": "pydmd_dmdc",
    "deepsi": "deepsi_subnet",
    "ridge": "regressor(estimator=Ridge)",
    "forest": "regressor(estimator=RandomForestRegressor)",
    "boosting": "regressor(estimator=HistGradientBoostingRegressor)",
    "network": "regressor(estimator=MLPRegressor)",
    "our_sindy": "sindy",
    "our_narx": "narx",
    "our_networks": "mlp_ensemble",
}
"""Packages, the usual regressors of scikit-learn with their own defaults, and three families of this project."""

HORIZONS = (1, 10, 20, 60, None)
"""Steps of a simulation; None for whole episodes."""
CANDIDATES, TRIALS = 10, 10


def compared(system: str, seed: int, models: Sequence[str], folder: Path, settings: Mapping[str, Any]) -> list[Any]:
    """Return a row for each model of ``system``: name, nine numbers (nan if unknown), verdict."""
    data, where = None, dict[str, Any](robot=system)
    if system in TEST_EPISODE:
        training, test = recording(system)
        data, where = training.with_episodes([*training, *test]), {"test": [TEST_EPISODE[system]]}
    chosen = {label: one if isinstance(one := MODELS[label], str) else one() for label in models}
    report = compare(
        data, out=folder, models=chosen, ensembles=(), seed=seed, reference=False, rounds=1, plugins=[PLUGIN],
        progress=True, **where, **settings,
    )  # fmt: skip
    fits, store = comparison_of(folder)[0].fits, Store(folder)
    return [row_of(label, report, store.outcome(fits[label]).value) for label in models]


def row_of(label: str, report: ComparisonResults, model: DynamicsModel | None) -> tuple[str, list[float], str]:
    """Return what a comparison found for one model, which is None if it could not be fitted."""
    predicted = () if report.prediction is None else report.prediction.models
    scored = next((one for one in predicted if one.name == label), None)  # none if it could not be fitted
    scores = [None if scored is None else scored.score(horizon) for horizon in HORIZONS]
    errors = [np.nan if score is None else score.n for score in scores]
    seconds = report.timings.get(f"fit {label}", np.nan)
    achieved, kept, verdict = np.nan, np.nan, "no controller"
    for one in () if report.transfer is None else report.transfer.controllers:
        if one.name == label and one.elsewhere is not None:
            achieved, kept = one.elsewhere.value, np.nan if one.kept is None else one.kept.value
            exploited = is_exploited(one.claimed, one.gap)
            verdict = "unknown" if exploited is None else "exploited" if exploited else "holds"
    per_million = np.nan if model is None else million_steps(model, report.settings["task"])
    return label, [*errors, seconds, per_million, achieved, kept], verdict


def million_steps(model: DynamicsModel, task: str) -> float:
    """Return the processor time of a million steps of rollouts in s, on one thread."""
    bound = make_task(Spec.parse(task)).bind(model.system)
    controller, seeds = make_controller("recurrent").bind_to(bound), trial_seeds(0, TRIALS)
    population = np.zeros((CANDIDATES, controller.n_parameters))
    rollout(model, controller, population[:1], bound, seeds[:1], threads=1)
    began = time.process_time()
    rollout(model, controller, population, bound, seeds, threads=1)
    return 1e6 * (time.process_time() - began) / (CANDIDATES * TRIALS * bound.horizon)


def table_of(system: str, rows: Sequence[Sequence[tuple[str, list[float], str]]]) -> Table:
    """Return the table of a system from the rows of all seeds."""
    table = Table(title=system, box=SIMPLE_HEAD, padding=(0, 1), collapse_padding=True)
    names = ("model", "N 1", "10", "20", "60", "whole", "fit s", "s/1e6 steps", "achieved", "of claim", "claim")
    for name in names:
        table.add_column(name, justify="left" if name in ("model", "claim") else "right", no_wrap=True)
    for seeds in zip(*rows, strict=True):
        columns = np.array([numbers for _, numbers, _ in seeds]).T
        verdicts = sorted({verdict for _, _, verdict in seeds})
        table.add_row(seeds[0][0], *map(spread, columns), ", ".join(verdicts))
    return table


def spread(values: np.ndarray[Any, Any]) -> str:
    """Return the mean of several seeds and half the distance of lowest and highest; "-" if one is not known."""
    if not np.isfinite(values).all():
        return "-"
    half = f" ± {np.ptp(values) / 2:.1g}" if np.ptp(values) > 0 else ""
    return f"{values.mean():.3g}{half}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the comparisons that are left, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--systems", nargs="*", default=SYSTEMS, choices=SYSTEMS)
    parser.add_argument("--models", nargs="*", default=list(MODELS), choices=list(MODELS))
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--preset", default="quick")
    parser.add_argument("--generations", type=int)
    parser.add_argument("--minutes", type=float, default=6.0, help="recorded on an emulated robot")
    parser.add_argument("--search-minutes", type=float, default=10.0)
    add_markdown(parser)
    chosen = parser.parse_args(arguments)
    settings = {"preset": chosen.preset, "generations": chosen.generations, "search_minutes": chosen.search_minutes}
    tables = []
    for system in chosen.systems:
        own = settings if system in TEST_EPISODE else {**settings, "minutes": chosen.minutes}
        rows = [
            compared(system, seed, chosen.models, chosen.out / f"{system}-{seed}", own) for seed in range(chosen.seeds)
        ]
        tables.append(table_of(system, rows))
    print_tables(tables, chosen.markdown, Console(width=200))


if __name__ == "__main__":
    main()
