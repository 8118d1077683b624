"""Measurements: commands on a long log, fits of every family, steps of fitted models."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from evaluation.chosen_models import with_preset
from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.engine import rollout
from sysid_evo.models.base import make_model
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import Spec, models
from sysid_evo.tasks import PointToPoint
from tests.benchmarks.growth.measuring import Growth, doubled
from tests.benchmarks.growth.recordings import long_car, write_log

PARTS = ("commands", "fits", "steps")
TRIALS = 10
STEPPED = {
    "linear": "",
    "sindy": "degree=2, control_lags=0, threshold=0.1",
    "gaussian_process": "inducing=60, state_lags=0, control_lags=0",
    "nearest_neighbour": "",
    "k_neighbours": "neighbours=8, state_lags=0, control_lags=0",
}
"""Models whose steps are timed, with all that would be searched for settled."""


def cases(quick: bool) -> Iterator[Growth]:
    """Yield everything; ``quick`` with sizes that only show that it runs."""
    yield from _commands(quick)
    yield from _fits(quick)
    yield from _steps(quick)


@lru_cache(maxsize=1)
def _folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="growth-")


def _commands(quick: bool) -> Iterator[Growth]:
    """The commands on a CSV log as separate processes, including their start."""
    sizes = (1_000, 2_000) if quick else (10_000, 30_000, 100_000, 300_000, 1_000_000)

    def importing(rows: int) -> list[str]:
        folder = Path(_folder().name) / str(rows)
        folder.mkdir(exist_ok=True)
        log, columns = write_log(folder, rows)
        return ["import", str(log), "--columns", str(columns), "--out", str(folder / "data")]

    yield Growth("commands", "sysid-evo import", "rows of a CSV log", sizes, command=importing)
    yield Growth(
        "commands",
        "sysid-evo inspect",
        "rows of a CSV log",
        sizes,
        command=lambda rows: ["inspect", str(Path(_folder().name) / str(rows) / "data")],
    )


FEW_UPDATES = {"one_step_updates": 20, "updates": 5}
SHORT: dict[str, dict[str, object]] = {
    "evolved3": {"generations": 5},
    "parametrised": {"generations": 5},
    "backprop27": {"epochs": 20},
    "torch_ode": {"updates": 5},
    **dict.fromkeys(("hybrid_ode", "mlp_ensemble", "neural_ode"), FEW_UPDATES),
}
"""Short fits of families whose updates are as many on few steps: what grows with the data is the rest."""


def _fits(quick: bool) -> Iterator[Growth]:
    """The fit of every family with the preset quick, shortened; those with ``max_steps`` stop growing there."""
    for name in models.names():
        yield Growth(
            "fits", f"fit {name}", "steps", doubled(4_000, 4_000 if quick else 256_000, 4), make=_fitting(name)
        )


def _fitting(name: str) -> Callable[[int], Callable[[], object]]:
    def make(size: int) -> Callable[[], object]:
        data, spec = long_car(size), with_preset(Spec(name, SHORT.get(name, {})), "quick")
        return lambda: make_model(spec).fit(data, rng=0)

    return make


def _steps(quick: bool) -> Iterator[Growth]:
    """A thousand compiled rollouts of ten steps on one thread, in a model fitted to a number of steps."""
    sizes = doubled(4_000, 8_000 if quick else 1_024_000, 4)
    for name, parameters in STEPPED.items():
        yield Growth(
            "steps", f"rollout, {name}", "steps of the data", sizes, make=_stepping(name, parameters), best=0.0
        )


def _stepping(name: str, parameters: str) -> Callable[[int], Callable[[], object]]:
    def make(size: int) -> Callable[[], object]:
        spec: Any = Spec.parse(f"{name}({parameters})") if parameters else Spec(name)
        model = make_model(spec).fit(long_car(size), rng=0)
        task, controller = PointToPoint(horizon=50), RecurrentNetwork()
        candidates = np.random.default_rng(0).standard_normal((100, 78))
        seeds = trial_seeds(0, TRIALS)
        return lambda: rollout(model, controller, candidates, task, seeds, threads=1)

    return make
