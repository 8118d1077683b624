"""What is looked at: a generation of evolution, the look at recordings, fits, steps of fitted models, their tests."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from evaluation.advice import advise_recording
from evaluation.planning import with_preset
from evaluation.prediction import PredictionProtocol, measured_cases, score_model
from evaluation.steps import Steps, training_support
from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.data import Dataset
from sysid_evo.engine import DynamicsRunner, rollout
from sysid_evo.evolution import EnsembleObjective
from sysid_evo.evolution.strategies.strategy import make_strategy
from sysid_evo.models import DynamicsModel
from sysid_evo.models.base import make_model
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import Spec
from sysid_evo.tasks import PointToPoint
from tests.benchmarks.growth.measuring import Growth, doubled
from tests.benchmarks.growth.recordings import long_car, write_log

PARTS = ("search", "strategies", "data", "commands", "fits", "steps", "tests")
POPULATION, TRIALS, HORIZON = 100, 10, 200
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
    yield from _search(quick)
    yield from _strategies(quick)
    yield from _data(quick)
    yield from _commands(quick)
    yield from _fits(quick)
    yield from _steps(quick)
    yield from _tests(quick)


def _search(quick: bool) -> Iterator[Growth]:
    """One generation in a compiled model on one thread: candidates run in all trials on all models."""

    usual = {"population": POPULATION, "trials": TRIALS, "models": 1, "hidden": 5, "horizon": HORIZON}

    def along(axis: str) -> Callable[[int], Callable[[], object]]:
        return lambda size: _generation(**{**usual, axis: size})

    top = 2 if quick else 16
    for axis, unit, first, best in (
        ("population", "candidates", POPULATION, 1.0),
        ("trials", "trials of a candidate", TRIALS, 1.0),
        ("models", "models in the ensemble", 1, 1.0),
        ("horizon", "steps of a trial", HORIZON, 1.0),
        ("hidden", "hidden units", 4, 2.0),
    ):
        note = "every hidden unit is connected to every other" if axis == "hidden" else ""
        yield Growth(
            "search",
            f"a generation, {axis}",
            unit,
            doubled(first, first * top),
            make=along(axis),
            best=best,
            note=note,
        )


@lru_cache(maxsize=1)
def _quick_model() -> DynamicsModel:
    return make_model("sindy", degree=2, threshold=0.1, control_lags=0).fit(long_car(2000), rng=0)


def _generation(*, population: int, trials: int, models: int, hidden: int, horizon: int) -> Callable[[], object]:
    task, controller = PointToPoint(horizon=horizon), RecurrentNetwork(hidden=hidden)
    n = controller.bind_to(task.bind(_quick_model().system)).n_parameters
    candidates = np.random.default_rng(0).standard_normal((population, n))
    runners = tuple(DynamicsRunner(_quick_model(), threads=1) for _ in range(models))
    objective = EnsembleObjective(runners, controller, task, seed=0, trials=trials)
    return lambda: objective(candidates, 0)


def _strategies(quick: bool) -> Iterator[Growth]:
    """`ask` and `tell` without rollouts."""
    sizes = doubled(64, 128 if quick else 2048)
    for name in ("mu_plus_lambda", "cma_es"):
        yield Growth(
            "strategies",
            f"`ask` and `tell`, {name}",
            "candidates",
            sizes,
            make=partial(_asking, name),
        )


def _asking(name: str, size: int) -> Callable[[], object]:
    half = {"parents": size // 2, "children": size - size // 2}
    chosen = half if name == "mu_plus_lambda" else {"population": size}
    rng = np.random.default_rng(0)

    def program() -> None:
        strategy = make_strategy(Spec(name, chosen), n_parameters=78, seed=0)
        for _ in range(3):
            population = strategy.ask()
            strategy.tell(population, rng.standard_normal(len(population)))

    return program


def _data(quick: bool) -> Iterator[Growth]:
    """Operations on recordings before a fit."""
    sizes = doubled(10_000, 20_000 if quick else 320_000)
    in_pieces = doubled(100, 200 if quick else 1_600)
    looks: dict[str, Callable[[Dataset], object]] = {
        "inspect (advice)": lambda data: advise_recording(_copy_of(data)),
        "windows of 20 steps": lambda data: data.windows(20, history=3, moving=True),
        "split by time": lambda data: _copy_of(data).split(0.25),
        "fingerprint": lambda data: _copy_of(data).fingerprint,
    }
    for name, look in looks.items():
        yield Growth("data", name, "steps", sizes, make=_on_steps(look))
    for name, look in {
        "inspect (advice)": looks["inspect (advice)"],
        "hold out a quarter of the episodes": lambda data: _copy_of(data).split(list(data.names[::4])),
    }.items():
        yield Growth("data", name, "episodes of 100 steps", in_pieces, make=_on_episodes(look))


def _copy_of(data: Dataset) -> Dataset:
    """Return a copy of the data without cached results."""
    return data.with_episodes(data.episodes)


def _on_steps(look: Callable[[Dataset], object]) -> Callable[[int], Callable[[], object]]:
    def make(size: int) -> Callable[[], object]:
        data = long_car(size)
        return lambda: look(data)

    return make


def _on_episodes(look: Callable[[Dataset], object]) -> Callable[[int], Callable[[], object]]:
    def make(size: int) -> Callable[[], object]:
        data = long_car(100 * size, episodes=size)
        return lambda: look(data)

    return make


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
    from sysid_evo.registry import models

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


def _tests(quick: bool) -> Iterator[Growth]:
    """Measurements on held-out data."""
    sizes = doubled(4_000, 8_000 if quick else 128_000)
    in_pieces = doubled(100, 200 if quick else 800)
    model = "linear"

    def with_data(test: Callable[[Dataset], Callable[[], object]]) -> Callable[[int], Callable[[], object]]:
        return lambda size: test(long_car(size))

    def scoring(data: Dataset) -> Callable[[], object]:
        fitted = make_model(model).fit(data, rng=0)
        return lambda: fitted.score(_copy_of(data))

    def predicting(data: Dataset) -> Callable[[], object]:
        fitted = make_model(model).fit(data, rng=0)
        return lambda: score_model(
            "linear", fitted, measured_cases(data, _copy_of(data), PredictionProtocol()), family=""
        )

    def supporting(data: Dataset) -> Callable[[], object]:
        steps = Steps.of(data.system, data.episodes)
        return lambda: steps.share_outside(training_support(data))

    for name, test in {
        "score": scoring,
        "prediction test": predicting,
        "share outside the data": supporting,
    }.items():
        yield Growth("tests", name, "steps", sizes, make=with_data(test))
    yield Growth(
        "tests",
        "prediction test",
        "episodes of 100 steps",
        in_pieces,
        make=lambda size: predicting(long_car(100 * size, episodes=size)),
    )
