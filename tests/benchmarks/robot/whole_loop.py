"""Record on the emulated car on its pseudo-terminal, fit, evolve, and drive the controller there: a command each."""

from __future__ import annotations

import subprocess
import time
from pathlib import Path

import numpy as np

from evaluation.transfer import load_measured
from tests.benchmarks.robot.outcome import Row

ROBOT, TWIN = "terminal_car", "emulated_car"
PLUGIN = "--plugin", Path(__file__).with_name("registered.py")
FAMILY = "parametrised"
ESTIMATOR_DELAY = "29ms"  # as reported by `sysid-evo robots check terminal_car --plugin ...`
SPREAD = 2.0  # standard deviations of the trials on the in-process car


def whole_loop(folder: Path, *, repeats: int, seed: int, minutes: float = 3.0, preset: str = "standard") -> list[Row]:
    """Do the four steps once and drive ``repeats`` trials; the in-process car drives the same trials."""
    data, run = folder / "data", folder / "run"
    seconds = {
        step: _command(*words)
        for step, words in {
            "record": ("record", *PLUGIN, "--robot", ROBOT, "--minutes", minutes, "--seed", seed, "--out", data),
            "fit": ("fit", data, "--models", FAMILY, "--preset", preset, "--seed", seed, "--out", run),
            "evolve": (
                *("evolve", "--against", FAMILY, "--run", run, "--preset", preset, "--seed", seed),
                *("--estimator-delay", ESTIMATOR_DELAY),
            ),
        }.items()
    }
    controller = next((run / "controllers").glob("*.safetensors"))
    for robot in (ROBOT, TWIN):
        words = ("drive", *PLUGIN, "--controller", controller, "--robot", robot, "--trials", repeats, "--run", run)
        seconds[f"drive {robot}"] = _command(*words)
    cells = {measured.cell.column: measured.cell for measured in load_measured(run)[0]}
    there, here = (next(cells[name] for name in cells if name.startswith(robot)) for robot in (ROBOT, TWIN))
    distance = abs(float(np.mean(there.fitness)) - float(np.mean(here.fitness)))
    holds = there.trials == here.trials == repeats and distance <= SPREAD * float(np.std(here.fitness))
    figures = {
        "achieved": f"{np.mean(there.fitness):.1f} {sorted(there.fitness)}",
        "in_process": f"{np.mean(here.fitness):.1f} {sorted(here.fitness)}",
        "seconds": {step: round(value) for step, value in seconds.items()},
    }
    demand = f"mean fitness within {SPREAD:g} standard deviations of the in-process car's"
    return [Row("record, fit, evolve, drive", demand, int(holds), 1, figures)]


def _command(*words: object) -> float:
    """Run ``sysid-evo`` and return its wall time in s. Raises `RuntimeError` with its output if it fails."""
    began = time.monotonic()
    done = subprocess.run(["sysid-evo", *map(str, words)], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"sysid-evo {' '.join(map(str, words))} ended with {done.returncode}: {done.stderr[-2000:]}")
    return time.monotonic() - began
