"""How often 90 % intervals hold the truth after 1, 10, 20 and 60 steps, on recordings that no fit has seen.

    python -m tests.benchmarks.coverage [FAMILY ...] [--preset quick] [--seeds 1] [--logs slippery_20hz emulated_car]

Every family is fitted with ``stochastic``; the share of the test set's moving targets inside the central 90 % of 100
samples is printed for each horizon, over all channels and of each, with N of the run without noise and what fitting
took. By default the families that give a spread and fit in seconds.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np

from model_zoo.validation.spread import SHARE
from sysid_evo.arrays import Array

FAMILIES = ("mlp_ensemble", "gaussian_process", "linear", "sindy", "sindy_bagged", "sindy_discrete", "narx")
FAMILIES += ("k_neighbours", "parametrised", "neural_ode")


def coverage(samples: Array, truth: Array, *, share: float = SHARE) -> Array:
    """Return how much of ``truth`` (N, nx) lies in the central ``share`` of ``samples`` (S, N, nx), (nx,)."""
    low, high = np.quantile(samples, [0.5 - share / 2, 0.5 + share / 2], axis=0, method="weibull")
    return ((truth >= low) & (truth <= high)).mean(axis=0)


def main() -> None:
    """Run the benchmark."""
    from evaluation.prediction import PredictionProtocol, measured_cases, score_model
    from sysid_evo.errors import IncompatibleSystem
    from sysid_evo.registry import make_model, models
    from tests.benchmarks.prediction import EMULATED, TEST_EPISODE, recording

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("families", nargs="*", default=list(FAMILIES))
    parser.add_argument("--preset", default="quick")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--logs", nargs="+", default=[*TEST_EPISODE, EMULATED], choices=[*TEST_EPISODE, EMULATED])
    arguments = parser.parse_args()
    for log in arguments.logs:
        training, test = recording(log)
        cases = measured_cases(training, test, PredictionProtocol())
        sys.stdout.write(f"\n{log}: share inside 90 % intervals (each channel), N after {cases.horizons} steps\n")
        for name in arguments.families:
            options = dict(models.get(name).presets.get(arguments.preset, {}))  # type: ignore[attr-defined]  # a class
            for seed in range(arguments.seeds):
                model, began = make_model(name, **options, stochastic=True), time.process_time()
                try:
                    model.fit(training, rng=seed)
                except IncompatibleSystem as error:
                    sys.stdout.write(f"  {name:20s} {error}\n")
                    continue
                took = time.process_time() - began
                scores = score_model(name, model, cases, family=name)
                figures = "  ".join(
                    f"{100 * np.mean(held.inside):3.0f} ({', '.join(f'{100 * one:.0f}' for one in held.inside)})"
                    for held in scores.coverage
                )
                errors = " ".join(f"{score.n:.3f}" for score in scores.at)
                sys.stdout.write(f"  {name:20s} {figures}  N {errors}  fit {took:.1f} s\n")
                sys.stdout.flush()


if __name__ == "__main__":
    main()
