"""Systems with a single measured output: ``python -m tests.benchmarks.hidden --seeds 3``.

Every family is fitted to the recording of each system (`tests.benchmarks.hidden.systems`, with ``--checks`` those of
`tests.benchmarks.hidden.check_systems`) and simulates a whole test record from sample 64, with the history that it
needs. The error over the remaining samples, or with ``--after 20`` that of the 20th step from every seventh sample, is
printed in standard deviations of the measured output (noise included) as the mean over seeds (lowest to highest), with
the processor time of a fit in s. ``true structure`` is the system's own equations, with parameters fitted by least
squares from first guesses that are off by 20 %; it uses the fact that a record begins at rest. With ``--out`` each line
is written at once, and finished lines are not repeated; use another file for another ``--steps``, ``--after`` or
``--preset``.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.optimize import least_squares

from sysid_evo import make_model
from sysid_evo.data import Dataset
from sysid_evo.errors import DataWarning
from sysid_evo.models import DynamicsModel
from sysid_evo.types import Array, IntArray
from tests.benchmarks.hidden.check_systems import CHECKS
from tests.benchmarks.hidden.systems import SYSTEMS, HiddenSystem
from tests.benchmarks.markdown import add_markdown, print_tables

BEGIN = 64
"""Sample of the test record at which simulations begin."""
STRIDE = 7
"""Samples from one simulation to the next, of those that are scored after a number of steps."""
TRUE = "true structure"
FAMILIES = (
    "linear(state_lags=15, control_lags=15)",
    "narx",
    "neural_ode(state_lags=1, control_lags=3, one_step_updates=500, updates=150)",
    "mlp_ensemble(members=3, hidden=[32, 32], one_step_updates=600, updates=200)",
    "linear_state_space",
    "nonlinear_state_space",
)
GUESSES, OFF = 6, 0.2
AT_ONCE, WIDTH = 4, 120
"""Families side by side in a table, and how wide it is."""
LOST = 100.0


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("families", nargs="*", help=f"by default {TRUE!r} and {', '.join(FAMILIES)}")
    parser.add_argument("--systems", nargs="*", choices=[*SYSTEMS, *CHECKS], help="by default those before the checks")
    parser.add_argument("--checks", action="store_true", help="the systems written after the last change of rules")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--steps", type=int, help="of the recording, by default as many as each system has")
    parser.add_argument("--preset", help="of the families, such as quick")
    parser.add_argument("--after", type=int, help="steps after which simulations are scored, by default over all")
    parser.add_argument("--out", type=Path)
    add_markdown(parser)
    options = parser.parse_args(arguments)
    warnings.simplefilter("ignore", DataWarning)
    families = options.families or [TRUE, *FAMILIES]
    known = {} if options.out is None or not options.out.exists() else read(options.out)
    available, names = SYSTEMS | CHECKS, options.systems or list(CHECKS if options.checks else SYSTEMS)
    for seed in range(options.seeds):
        for name in names:
            for family in families:
                if (family, name, seed) in known:
                    continue
                system = available[name] if options.steps is None else replace(available[name], steps=options.steps)
                error, seconds = measured(family, system, seed, options.preset, options.after)
                known[family, name, seed] = error, seconds
                if options.out is not None:
                    with options.out.open("a") as file:
                        file.write(json.dumps([family, name, seed, error, seconds]) + "\n")
    shown = list(tables(known, families, names, range(options.seeds)))
    print_tables(shown, options.markdown, Console(width=WIDTH))
    return 0


def read(path: Path) -> dict[tuple[str, str, int], tuple[float, float]]:
    """Return error and seconds of every family, system and seed that is known already."""
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    return {(family, name, seed): (error, seconds) for family, name, seed, error, seconds in rows}


def measured(
    family: str, system: HiddenSystem, seed: int, preset: str | None = None, after: int | None = None
) -> tuple[float, float]:
    """Return the simulation error on the test record, see `free_run_error`, and the processor time of the fit in s."""
    training, test = system.recordings(seed)
    began = time.process_time()
    if family == TRUE:
        parameters = true_structure(system, training, seed)
        seconds = time.process_time() - began
        run = test.episodes[0]
        some = scored(len(run), after)
        return relative(system.simulate(parameters, run.controls[:, 0])[some], run.states[some, 0], run.states), seconds
    model = make_model(family)
    model.set_params(**(model.presets[preset] if preset else {})).fit(training, rng=seed)
    return free_run_error(model, test, after), time.process_time() - began


def scored(steps: int, after: int | None) -> IntArray:
    """Return the samples of a record of ``steps`` whose errors count."""
    return np.arange(BEGIN + 1, steps + 1) if after is None else np.arange(BEGIN + after, steps + 1, STRIDE)


def free_run_error(model: DynamicsModel, test: Dataset, after: int | None = None) -> float:
    """Return the error from sample `BEGIN` of the only episode to its end, or ``after`` steps of many runs."""
    run, lags = test.episodes[0], model.n_lags
    some = scored(len(run), after)
    if after is None:
        history = slice(BEGIN - lags, BEGIN)
        simulated = model.simulate(run.states[BEGIN - lags : BEGIN + 1], run.controls[history], run.controls[BEGIN:])
    else:
        at = (some - after)[:, None]
        past = run.states[at + np.arange(-lags, 1)], run.controls[at + np.arange(-lags, 0)]
        simulated = model.simulate(*past, run.controls[at + np.arange(after)])[:, -1]
    return relative(simulated[:, 0], run.states[some, 0], run.states)


def relative(simulated: Array, measured: Array, all_measured: Array) -> float:
    """Return the root mean square error divided by the standard deviation of all measurements of a record."""
    return float(np.sqrt(np.mean((simulated - measured) ** 2)) / all_measured.std())


def true_structure(system: HiddenSystem, training: Dataset, seed: int) -> Array:
    """Return the parameters of the system's own equations, fitted from several guesses."""
    run, rng = training.episodes[0], np.random.default_rng(seed)

    def residuals(logarithms: Array) -> Array:
        off = (system.simulate(np.exp(logarithms), run.controls[:, 0]) - run.states[:, 0]) / run.states[:, 0].std()
        return np.clip(np.nan_to_num(off, nan=LOST), -LOST, LOST)

    guesses = [np.log(system.parameters) + OFF * rng.standard_normal(len(system.parameters)) for _ in range(GUESSES)]
    with np.errstate(all="ignore"):
        fits = [least_squares(residuals, guess, x_scale=0.1, max_nfev=60) for guess in guesses]
    return np.exp(min(fits, key=lambda fit: fit.cost).x)


def tables(
    known: dict[tuple[str, str, int], tuple[float, float]], families: list[str], systems: list[str], seeds: range
) -> Iterator[Table]:
    """Yield tables with a row for each system and columns for some families: errors, and the mean seconds of a fit."""
    for first in range(0, len(families), AT_ONCE):
        some = families[first : first + AT_ONCE]
        shown = Table(title="Simulation error over a test record, in standard deviations")
        shown.add_column("system", no_wrap=True)
        for family in some:
            shown.add_column(family, justify="right", overflow="fold")
        for name in systems:
            cells = []
            for family in some:
                errors = np.array([known[family, name, seed][0] for seed in seeds])
                cells.append(f"{errors.mean():.3f} ({errors.min():.3f} to {errors.max():.3f})")
            shown.add_row(name, *cells)
        seconds = [np.mean([known[family, name, seed][1] for name in systems for seed in seeds]) for family in some]
        shown.add_section()
        shown.add_row("seconds of a fit", *(f"{mean:.0f}" for mean in seconds))
        yield shown


if __name__ == "__main__":
    sys.exit(main())
