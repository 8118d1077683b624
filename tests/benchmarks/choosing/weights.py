"""The result of `auto` with other weights of structure classes, cutoffs and horizons, from the same fits.

    python -m tests.benchmarks.choosing.weights [RECORDING ...] [--preset standard] [--seeds 2]

RECORDING is one of `tests.benchmarks.choosing`. Candidates are fitted once for each seed, in folds and to all data.
Then each rule determines the accepted candidates and their weights (both depend on the rule, since the acceptance test
uses errors of means). A class of n members has the weight n to the power of 1 - P: with P = 0 all members have equal
weight, with 1 all classes, and `auto` uses 1/2. With cutoffs of 1 only the best candidate on the held-out data is
accepted (``best alone``). Others: the best of each class is kept within another class cutoff (1: not at all), and
candidates are compared after 10, 20 and 60 steps only. N is that of `tests.benchmarks.choosing` after 1, 10, 20 and 60
steps, averaged over the seeds, followed by its ratio to N with the rule of `auto`.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Sequence
from typing import Any
from unittest.mock import patch

import numpy as np

from evaluation.chosen_models import with_preset
from evaluation.prediction.scores import ModelPrediction
from evaluation.prediction.scoring import assess_model
from model_zoo.auto.fitting import FitOutcome, FitTask, FitWork
from sysid_evo.models import DynamicsModel
from sysid_evo.models.base import make_model
from sysid_evo.registry import Spec
from sysid_evo.types import Array
from tests.benchmarks.cars import TEST_EPISODE, pooled
from tests.benchmarks.choosing.__main__ import Fits

POWERS = (0.5, 0.0, 0.25, 0.75, 1.0)
OWN = f"P = {POWERS[0]:g}"
CHANGED: dict[str, dict[str, Any]] = {
    "best alone": {"cutoff": 1.0, "class_cutoff": 1.0},
    **{f"class cutoff {cutoff:g}": {"class_cutoff": cutoff} for cutoff in (1.0, 1.2, 1.6)},
    "10, 20, 60 steps": {"horizons": [10, 20, 60]},
}
"""Rules with the weights of `auto` and other parameters."""


def replayed(fits: Fits, preset: str, seed: int) -> dict[str, DynamicsModel]:
    """Return the result of `auto` for every rule."""
    memory: dict[tuple[int, int], FitOutcome] = {}

    class Remembering(FitWork):
        def outcomes(self, tasks: Sequence[FitTask]) -> dict[tuple[int, int], FitOutcome]:
            memory.update(super().outcomes([task for task in tasks if task.key not in memory]))
            return {task.key: simulated(task, memory[task.key]) for task in tasks}

    def become(power: float, **changed: Any) -> DynamicsModel:
        def weights(structures: Sequence[str]) -> Array:
            count = Counter(structures)
            found = np.array([count[structure] ** -power for structure in structures])
            return np.asarray(found / found.sum())

        spec = with_preset(Spec("auto"), preset)
        model = make_model(Spec(spec.name, {**spec.parameters, **changed}))
        with patch("model_zoo.auto.model.FitWork", Remembering), patch("model_zoo.auto.model.weights_of", weights):
            return model.fit(fits.training, rng=np.random.default_rng(seed))

    weighted = {f"P = {power:g}": become(power) for power in POWERS}
    return {**weighted, **{name: become(POWERS[0], **changed) for name, changed in CHANGED.items()}}


def simulated(task: FitTask, known: FitOutcome) -> FitOutcome:
    """Return the outcome of an earlier fit with the held-out simulation of ``task``, whose horizons may differ."""
    if task.trial is None or known.model is None:
        return known
    states = task.trial.run(known.model)
    return FitOutcome(known.model, states, task.trial.diverged(known.model, states))


def benchmark(name: str, preset: str, seeds: int) -> None:
    """Write what the rules reach on one recording."""
    write, fits = sys.stdout.write, Fits(name, None)
    horizons = [horizon for horizon in fits.cases.horizons if horizon is not None]
    write(f"\n{name}: N after {', '.join(map(str, horizons))} steps\n")
    rows: dict[str, list[ModelPrediction]] = {}
    for seed in range(seeds):
        for rule, model in replayed(fits, preset, seed).items():
            rows.setdefault(rule, []).append(assess_model(f"{rule}-{seed}", model, fits.cases, family="auto"))
            write(f"  seed {seed}, {rule}: {model.fit_note}\n")
            sys.stdout.flush()
    for rule, found in rows.items():
        each = [pooled(found, horizon).value for horizon in horizons]
        ratios = [one / pooled(rows[OWN], horizon).value for one, horizon in zip(each, horizons, strict=True)]
        shown = ("  ".join(f"{one:.3f}" for one in numbers) for numbers in (each, ratios))
        write(f"  {'   x '.join(shown)}   {rule}\n")


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", nargs="*", metavar="RECORDING")
    parser.add_argument("--preset", default="standard")
    parser.add_argument("--seeds", type=int, default=2)
    arguments = parser.parse_args()
    for name in arguments.recordings or TEST_EPISODE:
        benchmark(name, arguments.preset, arguments.seeds)


if __name__ == "__main__":
    main()
