"""The rollout engine compared with plain C and plain JAX: ``python -m tests.benchmarks.c_reference``.

Every model is fitted (or loaded from ``--folder``) and its .c file is compiled with the system's compiler. Then C, the
float32 engine on one thread and, less often, JAX and the NumPy reference run a generation in turn in one process, timed
by processor time: 100 evolved controllers in 10 trials of 500 steps. C and JAX get precomputed noise and waypoints. The
table shows million steps per second (medians), the median and range of the paired ratios engine / C, and the difference
of the mean fitness between C and the float64 reference.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.engine import rollout
from sysid_evo.randomness import trial_seeds
from sysid_evo.tasks import PointToPoint
from sysid_evo.types import Array
from tests.benchmarks.c_reference.compiled import Compiled
from tests.benchmarks.c_reference.export import FORMS
from tests.benchmarks.c_reference.models import SEED, TRIALS, dynamics, population

LATER = 10_000  # a generation that evolution does not reach: fresh trials
SHORTEST = 0.05  # s that a turn lasts at least
EVERY = {"numpy": 5, "jax": 3}
"""Forms that run only in every n-th round."""


def in_turn(programs: Mapping[str, Callable[[], Any]], repeats: int) -> dict[str, Array]:
    """Return processor seconds of each program, one number for each turn that it ran in."""
    calls, taken = {}, {name: list[float]() for name in programs}
    for name, program in programs.items():
        program()
        began = time.process_time()
        program()
        calls[name] = max(1, round(SHORTEST / max(time.process_time() - began, 1e-4)))
    for turn in range(repeats):
        for name, program in programs.items():
            if turn % EVERY.get(name, 1) == 0:
                began = time.process_time()
                for _ in range(calls[name]):
                    program()
                taken[name].append((time.process_time() - began) / calls[name])
    return {name: np.array(times) for name, times in taken.items()}


def measure(compiler: str, name: str, folder: Path, repeats: int, *, jax: bool, quick: bool) -> dict[str, Any]:
    """Return one row of the table."""
    task, seeds = PointToPoint(horizon=50 if quick else 500), trial_seeds(SEED, TRIALS, generation=LATER)
    model = dynamics(name, folder, seconds=60.0 if quick else 360.0)
    theta = population(name, model, folder, candidates=10 if quick else 100, generations=2 if quick else 60)

    def by(engine: Any) -> Array:
        return rollout(model, RecurrentNetwork(), theta, task, seeds, engine=engine, threads=1).fitness

    programs: dict[str, Callable[[], Array]] = {
        "c": Compiled(compiler, name, model, theta, task, seeds),
        "engine": lambda: by("float32"),
        "numpy": lambda: by("reference"),
    }
    if jax:
        from tests.benchmarks.c_reference import jax_forms

        form = jax_forms.program(name, model, theta, task, seeds)
        if form is not None:
            programs["jax"] = form
    seconds, exact = in_turn(programs, repeats), by("reference")
    steps, paired = theta.shape[0] * len(seeds) * task.horizon / 1e6, seconds["c"] / seconds["engine"]
    return {
        "model": name,
        "mean_fitness": float(exact.mean()),
        "off_percent": {
            form: float(100.0 * (program().mean() / exact.mean() - 1.0)) for form, program in programs.items()
        },
        "million_steps_per_second": {form: float(steps / np.median(times)) for form, times in seconds.items()},
        "engine_to_c": {"median": float(np.median(paired)), "least": float(paired.min()), "most": float(paired.max())},
    }


def table(rows: Sequence[dict[str, Any]]) -> Table:
    """Return the rows as a table of at most 80 columns."""
    shown = Table(title="Million steps a second, one thread", box=SIMPLE_HEAD, padding=(0, 1), collapse_padding=True)
    for column in ("model", "C", "engine", "JAX", "NumPy", "eng./C", "range", "C off"):
        shown.add_column(column, justify="left" if column == "model" else "right", no_wrap=True)
    for row in rows:
        speed, ratio = row["million_steps_per_second"], row["engine_to_c"]
        jax = speed.get("jax")
        shown.add_row(
            row["model"], f"{speed['c']:.1f}", f"{speed['engine']:.1f}", "" if jax is None else f"{jax:.1f}",
            f"{speed['numpy']:.1f}", f"{ratio['median']:.2f}", f"{ratio['least']:.2f}-{ratio['most']:.2f}",
            f"{row['off_percent']['c']:+.1f} %",
        )  # fmt: skip
    return shown


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, print the table, perhaps write JSON."""
    parser = argparse.ArgumentParser(prog="tests.benchmarks.c_reference", description=__doc__)
    parser.add_argument("--models", nargs="*", default=list(FORMS), choices=list(FORMS), metavar="MODEL")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--quick", action="store_true", help="small populations and little data: does it run?")
    parser.add_argument("--folder", type=Path, help="folder of fitted models (default: fit for this run only)")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    chosen = parser.parse_args(arguments)
    console, compiler = Console(), shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        console.print("There is no C compiler (cc or gcc) on this machine, so nothing is compared.")
        return
    jax = importlib.util.find_spec("jax") is not None
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as own, threadpool_limits(1):
        folder = chosen.folder or Path(own)
        folder.mkdir(parents=True, exist_ok=True)
        rows = [measure(compiler, name, folder, chosen.repeats, jax=jax, quick=chosen.quick) for name in chosen.models]
    console.print(table(rows))
    console.print(f"Processor time; load average at the start {load:.1f} on {os.cpu_count()} processors.")
    if not jax:
        console.print("JAX is not installed and was left out: pip install '.[bench]' brings it.", markup=False)
    if chosen.json is not None:
        chosen.json.write_text(json.dumps({"load": load, "models": rows}, indent=1))


if __name__ == "__main__":
    main()
