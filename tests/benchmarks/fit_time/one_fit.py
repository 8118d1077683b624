"""One fit in a process of its own: prints seconds and errors as a line of JSON.

    python one_fit.py TRAINING TEST FAMILY PRESET SEED

Run as a file, with the checkout to be measured as PYTHONPATH: it uses nothing of ``tests``. What is imported first is
not counted, but what only a fit imports is.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import numpy as np

from evaluation.comparison.model_cells import with_preset
from evaluation.prediction import PredictionProtocol, assess_model, measured_cases
from sysid_evo.data import Dataset
from sysid_evo.registry import Spec, make_model

HORIZONS = 1, 5, 20


class Silence:
    """A `Progress` that measures the longest time between two calls."""

    def __init__(self) -> None:
        self.last = time.perf_counter()
        self.longest = 0.0

    def __call__(self, done: int, total: int, note: str = "") -> None:
        now = time.perf_counter()
        self.longest, self.last = max(self.longest, now - self.last), now


def one_fit(training: Dataset, test: Dataset, family: str, preset: str, seed: int) -> dict[str, Any]:
    """Return processor, wall and longest silent seconds, lags, and N after each of `HORIZONS` and of the whole file."""
    model, silence = make_model(with_preset(Spec(family), preset)), Silence()
    processor, wall = time.process_time(), time.perf_counter()
    model.fit(training, rng=np.random.default_rng(seed), progress=silence)
    processor, wall = time.process_time() - processor, time.perf_counter() - wall
    cases = measured_cases(training, test, PredictionProtocol(horizons=HORIZONS, resamples=2))
    found = assess_model(family, model, cases, family=family)
    scores = [found.score(horizon) for horizon in (*HORIZONS, None)]
    errors = [float("nan") if score is None else score.n for score in scores]
    return {"processor": processor, "wall": wall, "silent": silence.longest, "lags": model.lags, "errors": errors}


def main() -> None:
    """Do what the command line says."""
    training, test, family, preset, seed = sys.argv[1:]
    found = one_fit(Dataset.load(training), Dataset.load(test), family, preset, int(seed))
    sys.stdout.write(json.dumps(found) + "\n")


if __name__ == "__main__":
    main()
