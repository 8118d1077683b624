"""Numbers that a change of structure must not move: ``python -m tests.references --write FOLDER | --compare FOLDER``.

    python -m tests.references --write build/references     # before the change
    python -m tests.references --compare build/references   # after it; exit code 1 if anything moved

What is compared: a recording of every emulated robot, what every family learns on three of them, how it simulates and
how controllers do on it, the fitness of eight controllers in six tasks on four robots in float32 and float64, five
champions, and the report of one comparison without its timings. Every array is stored with its SHA-256. A comparison
lists what is equal, what moved and by how much, what is gone and what is new.

Things are known by their registered names. About seven minutes on two cores.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from itertools import chain
from multiprocessing import get_context
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from rich.console import Console
from rich.table import Table
from safetensors.numpy import load_file, save_file

from evaluation import compare
from evaluation.report.report import to_json
from sysid_evo.controllers.controller import make_controller
from sysid_evo.data import Dataset
from sysid_evo.engine import rollout
from sysid_evo.errors import IncompatibleSystem, IncompatibleTask, InvalidArgument
from sysid_evo.evolution import ControllerEvolution, evolve_controller
from sysid_evo.models import save_model
from sysid_evo.models.base import make_model
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import Spec, make_robot, models
from sysid_evo.tasks.task import make_task

Found: TypeAlias = dict[str, "np.ndarray | str"]
"""What was found, by a path such as ``family/linear/pendulum/learned/weights_``: an array, or a text."""

ROBOTS = ("emulated_car", "awkward_car", "pendulum", "cart_pole", "thermal", "gymnasium")
MINUTES = 1.0
LEARNED_FROM = ("emulated_car", "awkward_car", "pendulum")
DRIVEN = ("emulated_car", "pendulum", "cart_pole", "thermal")
TASKS = ("point_to_point", "walled_track", "set_point", "track_reference", "balance", "swing_up")
CONTROLLERS = ("constant", "feed_forward", "linear", "lqr", "pid", "predictive", "pursuit", "recurrent")
WITH_MODEL: dict[str, dict[str, Any]] = {"lqr": {}, "predictive": {"horizon": 8, "samples": 8}}
"""Controllers that plan with a model; it is ``linear``, fitted to the recording."""
NETWORK = {"hidden": [8], "one_step_updates": 60, "updates": 30, "horizon": 5}
HIDDEN = {"members": 2, "order": 3, "screening_iterations": 3, "iterations": 3, "hidden": 4, "horizon": 60}
SMALL: dict[str, dict[str, Any]] = {
    "auto": {"candidates": ["linear(state_lags=1, control_lags=2)", "narx(state_lags=1, terms=8)"], "cutoff": 9.0},
    "backprop27": {"epochs": 40},
    "evolved3": {"generations": 10},
    "gaussian_process": {"inducing": 40},
    "hybrid_ode": NETWORK,
    "latent_ode": HIDDEN,
    "linear_state_space": {"order": 3, "iterations": 5, "folds": 1, "horizon": 60},
    "mlp_ensemble": {**NETWORK, "members": 2, "control_lags": 1},
    "neural_ode": NETWORK,
    "nonlinear_state_space": HIDDEN,
    "parametrised": {"generations": 20},
    "single_track": {"starts": 1, "windows": 20},
    "torch_ode": {"hidden": [8], "updates": 20, "horizon": 3, "control_lags": 1},
}
"""Budgets of families that learn for long; others learn as they do by default."""
CHAMPIONS: dict[str, tuple[str, dict[str, Any]]] = {
    "the paper's": ("emulated_car", {"strategy": "mu_plus_lambda"}),
    "cma_es": ("emulated_car", {"strategy": "cma_es", "aggregate": "cvar"}),
    "niches": (
        "emulated_car",
        {
            "strategy": "niches",
            "noise": "domain_randomisation",
        },
    ),
    "swing_up": ("pendulum", {"strategy": "mu_plus_lambda", "task": "swing_up(horizon=80)", "aggregate": "median"}),
}
"""How four champions are evolved, each in two models of a robot."""
CANDIDATES, TRIALS, STEPS, WINDOW = 4, 3, 60, 40
FOLDER_FILES = ("references.json", "references.safetensors")


def recorded(robot: str) -> Found:
    """Return every episode of a recording of ``robot``."""
    return {
        f"recording/{robot}/{k}/{part}": array
        for k, episode in enumerate(recording(robot).episodes)
        for part, array in (("states", episode.states), ("controls", episode.controls), ("pose", episode.pose))
        if array is not None
    }


def recording(robot: str) -> Dataset:
    """Return a recording of ``robot``, the same at every call."""
    return make_robot(robot).record(seed=3, duration=60.0 * MINUTES).dataset


def learned(family: str, robot: str) -> Found:
    """Return the learned values of ``family`` on a recording of ``robot``, and its simulations of that recording."""
    where, dataset = f"family/{family}/{robot}", recording(robot)
    try:
        model = make_model(family, **SMALL.get(family, {})).fit(dataset, rng=np.random.default_rng(7))
    except (IncompatibleSystem, InvalidArgument) as error:
        return {where: type(error).__name__}
    with tempfile.TemporaryDirectory() as folder:
        file = save_model(model, Path(folder) / "model")
        tensors = load_file(file.with_suffix(".safetensors"))
        manifest = json.loads(file.with_suffix(".json").read_text(encoding="utf-8"))
    found: Found = {f"{where}/learned/{name}": array for name, array in tensors.items()}
    found |= flat(f"{where}/parameters", manifest["parameters"]) | flat(f"{where}/learned", manifest["learned"])
    return found | {f"{where}/simulated": simulated(model, dataset), f"{where}/driven": driven(model)}


def simulated(model: Any, dataset: Dataset) -> np.ndarray:
    """Return simulations (B, WINDOW + 1, nx) from the first steps of the longer episodes."""
    lags = model.n_lags
    long = [one for one in dataset.episodes if len(one.controls) >= lags + WINDOW]
    return np.asarray(
        model.simulate(
            np.stack([one.states[: lags + 1] for one in long]),
            np.stack([one.controls[:lags] for one in long]),
            np.stack([one.controls[lags : lags + WINDOW] for one in long]),
        )
    )


def driven(model: Any) -> np.ndarray:
    """Return the fitness of small networks that drive ``model``, in the form that evolution takes."""
    task = make_task("point_to_point" if model.system.motion else "swing_up", horizon=STEPS).bind(model.system)
    controller = make_controller("recurrent").bind_to(task)
    population = np.random.default_rng(5).normal(size=(CANDIDATES, controller.n_parameters))
    return rollout(model, controller, population, task, trial_seeds(11, TRIALS)).fitness


def fitness(robot: str) -> Found:
    """Return the fitness of every controller in every task on ``robot``; where it cannot be, the class of the error."""
    dynamics, dataset = make_robot(robot).dynamics, recording(robot)
    model = make_model("linear").fit(dataset, rng=np.random.default_rng(0))
    found: Found = {}
    for task in TASKS:
        for name in CONTROLLERS:
            given = {"model": model, **WITH_MODEL[name]} if name in WITH_MODEL else {}
            for engine in ("float32", "float64"):
                where = f"fitness/{robot}/{task}/{name}/{engine}"
                try:
                    bound = make_task(task, horizon=STEPS).bind(dynamics.system)
                    controller = make_controller(name, **given).bind_to(bound)
                    population = np.random.default_rng(5).normal(size=(CANDIDATES, controller.n_parameters))
                    run = rollout(dynamics, controller, population, bound, trial_seeds(11, TRIALS), engine=engine)
                except (IncompatibleTask, IncompatibleSystem, InvalidArgument) as error:
                    found[where] = type(error).__name__
                else:
                    found[where] = run.fitness
    return found


def champion(name: str) -> Found:
    """Return the parameters, history and finalists of a short evolution."""
    robot, options = CHAMPIONS[name]
    dataset = recording(robot)
    runners = {
        family: make_model(family).fit(dataset, rng=np.random.default_rng(0))
        for family in ("linear", "nearest_neighbour")
    }
    settings = {"task": "point_to_point(horizon=80)", "controller": "recurrent", **options}
    specs = {key: Spec.parse(settings.pop(key)) for key in ("task", "controller", "strategy")}
    evolution = ControllerEvolution(generations=20, trials=3, selection_trials=10, **specs, **settings)
    best = evolve_controller("champion", runners, dataset.system, evolution, seed=1)
    tensors = {f"champion/{name}/{key}": np.asarray(array) for key, array in best.tensors.items()}
    return tensors | flat(f"champion/{name}/described", best.to_dict())


def report(_: str) -> Found:
    """Return every number and text of the report of a comparison, except times and paths."""
    with tempfile.TemporaryDirectory() as folder:
        made = compare(
            out=Path(folder) / "run",
            models=["linear", "near=nearest_neighbour", "parametrised(generations=10)"],
            ensembles=["linear+near"],
            robot="emulated_car",
            minutes=MINUTES,
            preset="quick",
            strategy="mu_plus_lambda",
            generations=6,
            trials=3,
            transfer_trials=10,
            baselines=["pursuit"],
            seed=2,
        )
    return {
        key: value
        for key, value in flat("report", to_json(made)).items()
        if not re.search(r"/(timings|seconds|versions|digest|machine)(/|$)", key)
    }


def flat(where: str, value: Any) -> Found:
    """Return the leaves of strict JSON by their paths: numbers as arrays, the rest as text."""
    if isinstance(value, Mapping):
        return dict(chain.from_iterable(flat(f"{where}/{key}", one).items() for key, one in value.items()))
    if isinstance(value, (list, tuple)):
        numbers = [one for one in value if isinstance(one, (int, float)) and not isinstance(one, bool)]
        if value and len(numbers) == len(value):
            return {where: np.array(value, dtype=np.float64)}
        return dict(chain.from_iterable(flat(f"{where}/{k}", one).items() for k, one in enumerate(value)))
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return {where: np.array(value, dtype=np.float64)}
    return {where: json.dumps(value)}


def jobs() -> Iterator[tuple[Callable[..., Found], tuple[str, ...]]]:
    """Yield every job, the longest first."""
    yield report, ("",)
    yield from ((fitness, (robot,)) for robot in DRIVEN)
    yield from ((champion, (name,)) for name in CHAMPIONS)
    yield from ((learned, (family, robot)) for family in models.names() for robot in LEARNED_FROM)
    yield from ((recorded, (robot,)) for robot in ROBOTS)


def measured(processes: int, only: str) -> Found:
    """Run all jobs whose name contains ``only``, in parallel; the result of a failed job is its error text."""
    found: Found = {}
    progress = Console(stderr=True)
    work = [job for job in jobs() if only in "/".join((job[0].__name__, *job[1]))]
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        for (job, names), done in [((job, names), pool.submit(guarded, job, names)) for job, names in work]:
            result, complaint = done.result()
            found |= result
            progress.print("/".join((job.__name__, *names)), complaint or f"{len(result)} entries", highlight=False)
    return found


def guarded(job: Callable[..., Found], names: tuple[str, ...]) -> tuple[Found, str]:
    """Run one job; an error is its result."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return job(*names), ""
        except Exception as error:
            complaint = f"{type(error).__name__}: {error}"
            return {"/".join(("failed", job.__name__, *names)): type(error).__name__}, complaint


def digest(value: np.ndarray | str) -> str:
    """Return the SHA-256 of an array with its type and shape, or of a text."""
    if isinstance(value, str):
        return hashlib.sha256(value.encode()).hexdigest()
    array = np.ascontiguousarray(value)
    return hashlib.sha256(f"{array.dtype}{array.shape}".encode() + array.tobytes()).hexdigest()


def write(found: Found, folder: Path) -> None:
    """Store what was found: digests and texts in one file, arrays in the other."""
    folder.mkdir(parents=True, exist_ok=True)
    entries = {
        key: {"sha256": digest(value), **({"text": value} if isinstance(value, str) else {})}
        for key, value in sorted(found.items())
    }
    arrays = {key: np.ascontiguousarray(value) for key, value in found.items() if not isinstance(value, str)}
    (folder / FOLDER_FILES[0]).write_text(json.dumps(entries, indent=1), encoding="utf-8")
    save_file(arrays, folder / FOLDER_FILES[1])


def read(folder: Path) -> Found:
    """Return the stored values. Raises `SystemExit` if an array differs from its digest."""
    entries = json.loads((folder / FOLDER_FILES[0]).read_text(encoding="utf-8"))
    arrays = load_file(folder / FOLDER_FILES[1])
    found: Found = {key: entry["text"] if "text" in entry else arrays[key] for key, entry in entries.items()}
    damaged = [key for key, value in found.items() if digest(value) != entries[key]["sha256"]]
    if damaged:
        raise SystemExit(f"{folder}: {len(damaged)} entries differ from their digests, first {damaged[0]}")
    return found


def difference(before: np.ndarray | str, after: np.ndarray | str) -> str:
    """Return the change of a value as text, empty if there is none."""
    if digest(before) == digest(after):
        return ""
    if isinstance(before, str) or isinstance(after, str):
        return f"{shortened(before)} -> {shortened(after)}"
    if before.shape != after.shape or before.dtype != after.dtype:
        return f"{before.dtype}{before.shape} -> {after.dtype}{after.shape}"
    if not before.size or before.dtype == bool:
        return f"{int(np.sum(before != after))} of {before.size} values"
    first, second = before.astype(np.float64), after.astype(np.float64)
    apart = np.abs(first - second)
    scale = np.nanmax(np.abs(first), initial=0.0)
    many = int(np.sum(~((first == second) | (np.isnan(first) & np.isnan(second)))))
    return f"{many} of {before.size} values, by {np.nanmax(apart, initial=0.0):.3g} at most (largest value {scale:.3g})"


def shortened(value: np.ndarray | str) -> str:
    """Return a text of at most 60 characters, or type and shape of an array."""
    return value[:60] if isinstance(value, str) else f"{value.dtype}{value.shape}"


def listed(before: Found, after: Found) -> tuple[Table, list[str]]:
    """Return a table of equal, changed, missing and new values in each group, and a line for each difference."""
    groups: dict[str, list[int]] = {}
    lines = []
    for key in sorted({*before, *after}):
        counts = groups.setdefault("/".join(key.split("/")[:2]), [0, 0, 0, 0])
        if key not in after or key not in before:
            place, said = (2, "gone") if key in before else (3, "new")
        else:
            said = difference(before[key], after[key])
            place = 1 if said else 0
        counts[place] += 1
        if said:
            lines.append(f"{key}: {said}")
    table = Table("", "equal", "moved", "gone", "new", box=None)
    for name, counts in [*groups.items(), ("all", [sum(column) for column in zip(*groups.values(), strict=True)])]:
        table.add_row(name, *map(str, counts))
    return table, lines


def main(arguments: Iterable[str] | None = None) -> int:
    """Write or compare; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--write", type=Path, metavar="FOLDER", help="store the numbers of this tree")
    what.add_argument(
        "--compare", type=Path, metavar="FOLDER", help="compare the numbers of this tree with stored ones"
    )
    parser.add_argument("--only", default="", help="part of a name, such as champion/ or learned/linear")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="with --compare: also store what was found now")
    given = parser.parse_args(arguments)
    out = Console()
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "SYSID_EVO_JOBS"):
        os.environ.setdefault(name, "1")
    before = None if given.compare is None else read(given.compare)
    found = measured(given.processes, given.only)
    folder = given.write or given.keep
    if folder is not None:
        write(found, folder)
    if before is None:
        out.print(f"{len(found)} entries stored in {folder}")
        return 0
    if given.only:
        before = {key: value for key, value in before.items() if key in found}
    table, lines = listed(before, found)
    for line in lines:
        out.print(line, markup=False, highlight=False, soft_wrap=True)
    out.print(table)
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
