"""The project's rollout engine against hand-written C and plain JAX: python run.py [--models a,b] [--repeats 15] [--json FILE].

Run with the project's interpreter, from anywhere. For every model: fits it (or loads it), compiles <model>.c, then times
C, the float32 engine on one thread and, less often, JAX and the NumPy reference, in turn in one process, by processor
time. One generation is 100 evolved candidates in 10 trials of 500 steps. Columns: million steps a second (medians), the
median of the paired ratios engine / C with its quartiles, engine / JAX, engine / NumPy, and how far the mean fitness of
C, engine and JAX is from that of the float64 reference. C and JAX get the trials' noise and waypoints ready made.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import subprocess
import tempfile
import time
from pathlib import Path

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(variable, "1")
import numpy as np

try:
    from tests.benchmarks.c_reference import jax_forms as jax
except ImportError:  # only the JAX column is left out
    jax = None
from tests.benchmarks.c_reference.export import export
from tests.benchmarks.c_reference.models import FAMILIES, SEED, TRIALS, dynamics, population
from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.engine import rollout
from sysid_evo.randomness import step_noise, trial_seeds
from sysid_evo.tasks import PointToPoint

HERE = Path(__file__).parent
FLAGS = "-O3 -march=native -ffast-math -mprefer-vector-width=512 -Wno-psabi -shared -fPIC -std=gnu11".split()
NAMES = (*FAMILIES, "emulated_car")


def pointer(array):
    return array.ctypes.data_as(ctypes.c_void_p)


class Compiled:
    """A model's closed loop in C."""

    def __init__(self, name, model, theta, task, seeds, flags):
        parameters, sizes = export(name, model, seeds)
        macros = [f"-D{key}={value}" for key, value in sizes.items()]
        with tempfile.TemporaryDirectory() as folder:
            library = f"{folder}/{name}.so"
            subprocess.run(["gcc", *FLAGS, *flags, *macros, HERE / f"{name}.c", "-o", library, "-lm"], check=True)
            self.rollout = ctypes.CDLL(library).rollout
        low, high = np.full((2, 3), 1e30) * [[-1], [1]] if model.envelope is None else model.envelope
        bound = task.bind(model.system)
        drawn = np.zeros((task.horizon, model.n_noise, 16), np.float32)
        if model.n_noise:
            drawn[:, :, : len(seeds)] = step_noise(seeds, task.horizon, model.n_noise).transpose(1, 2, 0)
        self.arrays = [
            np.ascontiguousarray(array, np.float32)
            for array in (
                parameters, [model.system.dt, task.waypoint_radius**2, *low, *high], theta,
                bound.begin(seeds).waypoints, drawn, np.zeros((len(theta), len(seeds))),
            )
        ]  # fmt: skip
        self.shape = len(theta), len(seeds), task.horizon

    def __call__(self):
        parameters, settings, theta, waypoints, noise, fitness = map(pointer, self.arrays)
        candidates, trials, horizon = self.shape
        self.rollout(parameters, settings, theta, candidates, waypoints, trials, horizon, noise, fitness)
        return self.arrays[-1]


def in_turn(programs, repeats, shortest=0.05):
    """Return processor seconds (repeats,) of each program; every turn lasts at least ``shortest`` seconds."""
    calls, taken = {}, {name: [] for name in programs}
    for name, (program, _) in programs.items():
        program()
        began = time.process_time()
        program()
        calls[name] = max(1, round(shortest / max(time.process_time() - began, 1e-4)))
    for turn in range(repeats):
        for name, (program, every) in programs.items():
            if turn % every == 0:
                began = time.process_time()
                for _ in range(calls[name]):
                    program()
                taken[name].append((time.process_time() - began) / calls[name])
    return {name: np.array(times) for name, times in taken.items()}


def measure(name, folder, repeats, flags):
    model, task, seeds = dynamics(name, folder), PointToPoint(), trial_seeds(SEED, TRIALS, generation=10_000)
    theta = population(name, model, folder)
    c = Compiled(name, model, theta, task, seeds, flags)

    def by(engine):
        return rollout(model, RecurrentNetwork(), theta, task, seeds, engine=engine, threads=1).fitness

    steps = theta.shape[0] * len(seeds) * task.horizon / 1e6
    programs = {"c": (c, 1), "engine": (lambda: by("float32"), 1), "numpy": (lambda: by("reference"), 5)}
    if jax is not None and (form := jax.program(name, model, theta, task, seeds)) is not None:
        programs["jax"] = (form, 3)
    seconds, exact = in_turn(programs, repeats), by("reference")
    return {
        "model": name,
        "fitness": float(exact.mean()),
        "off": {form: float(program().mean() / exact.mean() - 1) for form, (program, _) in programs.items()},
        "equal": float((c() == exact).mean()),
        "speed": {form: float(steps / np.median(times)) for form, times in seconds.items()},
        "ratio": np.quantile(seconds["c"] / seconds["engine"], (0.5, 0.25, 0.75)).tolist(),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--models", default=",".join(NAMES))
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument(
        "--folder", type=Path, default=Path(tempfile.gettempdir()) / "c_reference", help="where fitted models are kept"
    )
    parser.add_argument("--flags", default="", help="further flags for gcc")
    parser.add_argument("--json", type=Path)
    chosen = parser.parse_args()
    chosen.folder.mkdir(exist_ok=True)
    print(
        f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors; million steps a second, one thread, processor time"
    )
    print(
        f"{'model':<18}{'C':>7}{'engine':>8}{'JAX':>7}{'NumPy':>7}{'eng./C':>8} {'quartiles':<10}{'/JAX':>6}{'/NumPy':>7}  mean fitness, C off by, engine, JAX"
    )
    rows = []
    for name in chosen.models.split(","):
        row = measure(name, chosen.folder, chosen.repeats, chosen.flags.split())
        speed, (middle, low, high) = row["speed"], row["ratio"]
        jax_speed = speed.get("jax", np.nan)
        print(
            f"{name:<18}{speed['c']:7.1f}{speed['engine']:8.1f}{jax_speed:7.2f}{speed['numpy']:7.2f}{middle:8.2f} {low:.2f}-{high:.2f} "
            f"{speed['engine'] / jax_speed:6.1f}{speed['engine'] / speed['numpy']:7.1f}  {row['fitness']:6.3f} "
            + " ".join(f"{row['off'].get(form, np.nan):+.2%}" for form in ("c", "engine", "jax")),
            flush=True,
        )
        rows.append(row)
    if chosen.json:
        chosen.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
