"""Presets of `auto` against each other and against the best single candidate, from the same fits.

    python -m tests.benchmarks.choosing.presets [RECORDING ...] [--presets standard quick] [--seeds 1] [--out FILE]
    python -m tests.benchmarks.choosing.presets --read FILE ... [--markdown FILE]

RECORDING is one of `tests.benchmarks.choosing`. A fit that several presets need is computed once, in this process, on
one processor; the time of a preset is the processor time of all its fits and of its own work. Candidates are fitted
alone to all data, too, if their held-out error is at most 1.5 times the lowest in the first preset. N is that of
`tests.benchmarks.choosing` after 10, 20 and 60 steps and over whole recordings, the mean over the seeds. The best
single candidate has the lowest N after 20 steps; the last table, in which each seed is compared with its own best,
compares with the lowest of all candidates at every horizon, too.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from rich.console import Console
from rich.table import Table

from evaluation.chosen_models import with_preset
from evaluation.prediction.scoring import assess_model
from model_zoo.auto.candidates import candidates_for
from model_zoo.auto.fitting import FitOutcome, FitTask, FitWork, fitted
from sysid_evo.models import DynamicsModel
from sysid_evo.models.base import make_model
from sysid_evo.processors import use_processors
from sysid_evo.registry import Spec
from sysid_evo.types import Array
from sysid_evo.validation.folds import make_folds
from tests.benchmarks.cars import TEST_EPISODE, pooled
from tests.benchmarks.choosing.__main__ import ROBOTS, SIMULATED, Fits
from tests.benchmarks.markdown import add_markdown, per_cents, print_tables, thousandths

HORIZONS = (10, 20, 60, None)
JUDGED = HORIZONS.index(20)
HOPELESS = 1.5
"""Multiple of the lowest held-out error of a kept candidate above which another is not fitted alone."""
MEAN, CLOSE, FAR = 0.03, 0.10, 0.20
"""Aims: the mean excess over the best single candidate, that of nine in ten cells, and the largest."""


@dataclass(frozen=True)
class Row:
    """N at `HORIZONS` of a preset of `auto` or of a candidate alone, and the processor time of its fits in s."""

    recording: str
    seed: int
    name: str
    alone: bool
    n: list[float]
    seconds: float
    note: str = ""


class Memory:
    """Fits and their processor times, by what determines them."""

    def __init__(self) -> None:
        self.known: dict[tuple[str, str, str, int, bool], tuple[FitOutcome, float]] = {}

    def outcome(self, task: FitTask) -> tuple[FitOutcome, float]:
        """Return the outcome of ``task`` and its processor time in s, that of the first time."""
        settings = json.dumps(task.parameters, sort_keys=True, default=str)
        key = task.name, settings, task.dataset.fingerprint, task.seed, task.trial is None
        if key not in self.known:
            began = time.process_time()
            self.known[key] = fitted(task), time.process_time() - began
        return self.known[key]

    def fit(self, model: DynamicsModel, fits: Fits, seed: int) -> float:
        """Fit a model `auto`; return the processor time in s."""
        began, spent = time.process_time(), 0.0

        class Remembering(FitWork):
            def outcomes(work, tasks: Sequence[FitTask]) -> dict[tuple[int, int], FitOutcome]:  # noqa: N805
                nonlocal began, spent
                entered, found = time.process_time(), {}
                for task in tasks:
                    found[task.key], seconds = self.outcome(task)
                    spent += seconds
                began += time.process_time() - entered
                return found

        with patch("model_zoo.auto.model.FitWork", Remembering):
            model.fit(fits.training, rng=np.random.default_rng(seed))
        return spent + time.process_time() - began


def measured(fits: Fits, presets: Sequence[str], seed: int, memory: Memory) -> Iterable[Row]:
    """Yield the presets on one recording, then every candidate alone with the seed that it has in `auto`."""

    def row(name: str, model: DynamicsModel, seconds: float, *, alone: bool) -> Row:
        found = assess_model(f"{name}-{seed}", model, fits.cases, family="auto")
        n = [pooled([found], horizon).value for horizon in HORIZONS]
        return Row(fits.name, seed, name, alone, n, seconds, "" if alone else model.fit_note)

    far: dict[str, bool] = {}
    for preset in presets:
        model: Any = make_model(with_preset(Spec("auto"), preset))
        seconds = memory.fit(model, fits, seed)
        yield row(preset, model, seconds, alone=False)
        error = dict(zip(model.candidates_, model.errors_.mean(axis=1), strict=True))
        if preset == presets[0]:  # errors of candidates that were dropped may be of one fold only
            lowest = min(found for found, share in zip(error.values(), model.shares_, strict=True) if share > 0.0)
            far = {name: found > HOPELESS * lowest for name, found in error.items()}
    candidates, _ = candidates_for(fits.training.system)
    pairs = make_folds(fits.training, 3)
    seeds = np.random.default_rng(seed).integers(2**32, size=(len(candidates), len(pairs) + 1))
    for candidate, own in zip(candidates, seeds[:, -1], strict=True):
        if far.get(candidate.name, far.get(candidate.successor_of, False)):
            continue
        task = FitTask((0, 0), candidate.spec.name, candidate.spec.parameters, fits.training, int(own), 0.0)
        outcome, seconds = memory.outcome(task)
        if outcome.model is not None:
            yield row(candidate.name, outcome.model, seconds, alone=True)


def tables(rows: Sequence[Row]) -> list[Table]:
    """Return the errors on every recording, and how far each preset is above the best single candidate."""
    groups: dict[tuple[str, bool, str], list[Row]] = defaultdict(list)
    trials: dict[tuple[str, int], dict[tuple[bool, str], Array]] = defaultdict(dict)
    for row in rows:
        groups[row.recording, row.alone, row.name].append(row)
        trials[row.recording, row.seed][row.alone, row.name] = np.array(row.n)
    presets = list(dict.fromkeys(row.name for row in rows if not row.alone))
    errors = Table("recording", *(f"`{preset}`" for preset in presets), "best single candidate", "its name")
    for recording in dict.fromkeys(row.recording for row in rows):
        n_seeds = sum(where == recording for where, _ in trials)
        mean = {  # a candidate that was not fitted with every seed is left out: seeds differ in level
            (single, name): np.mean([row.n for row in own], axis=0)
            for (where, single, name), own in groups.items()
            if where == recording and len(own) == n_seeds
        }
        spent = (np.mean([row.seconds for row in groups[recording, False, preset]]) for preset in presets)
        alone = {name: n for (single, name), n in mean.items() if single}
        best = min(alone, key=lambda name: alone[name][JUDGED])
        cells = (f"{thousandths(mean[False, preset])}, {s:.0f} s" for preset, s in zip(presets, spent, strict=True))
        errors.add_row(recording, *cells, thousandths(alone[best]), f"`{best}`")
    each: dict[str, list[Array]] = defaultdict(list)
    for found in trials.values():
        alone = {name: n for (single, name), n in found.items() if single}
        best = min(alone, key=lambda name: alone[name][JUDGED])
        lowest = np.min(list(alone.values()), axis=0)
        for preset in presets:
            n = found[False, preset]
            each[f"{preset}, best single"].append(n / alone[best] - 1.0)
            each[f"{preset}, lowest at each horizon"].append(n / lowest - 1.0)
            if preset != presets[-1]:
                each[f"{preset}, {presets[-1]}"].append(n / found[False, presets[-1]] - 1.0)
    told = Table("against", "10", "20", "60", "file, %", "all, %", f"within {CLOSE:.0%}", "largest, %", "aims")
    for name, excesses in each.items():
        excess = np.array(excesses)
        near, most = float(np.mean(excess <= CLOSE)), float(excess.max())
        met = excess.mean() <= MEAN, near >= 1.0 - CLOSE, most <= FAR
        shares = [f"{100.0 * value:+.1f}" for value in (*excess.mean(axis=0), excess.mean())]
        told.add_row(name, *shares, per_cents([near]) + " %", f"{100.0 * most:+.0f}", f"{sum(met)} of 3")
    return [errors, told]


def main(arguments: list[str] | None = None) -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", nargs="*", metavar="RECORDING")
    parser.add_argument("--presets", nargs="+", default=["standard", "quick"])
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--out", type=Path, help="where rows are written, after every recording")
    parser.add_argument("--read", type=Path, nargs="+", default=[])
    add_markdown(parser)
    given = parser.parse_args(arguments)
    rows = [Row(**stored) for file in given.read for stored in json.loads(file.read_text())]
    use_processors(1)
    for name in () if rows else given.recordings or (*TEST_EPISODE, *ROBOTS, *SIMULATED):
        fits = Fits(name, None)
        for seed in range(given.seeds):
            for row in measured(fits, given.presets, seed, Memory()):
                rows.append(replace(row, n=[float(value) for value in row.n]))
                sys.stdout.write(f"{name}, {row.name}: {thousandths(row.n)}  {row.seconds:.0f} s  {row.note}\n")
                sys.stdout.flush()
        if given.out is not None:
            given.out.write_text(json.dumps([asdict(row) for row in rows], indent=1))
    print_tables(tables(rows), given.markdown, Console(width=200))


if __name__ == "__main__":
    main()
