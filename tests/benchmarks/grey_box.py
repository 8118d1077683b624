"""Fits the car's grey boxes on two real cars and the emulated one, and prints errors, times and parameters.

    python -m tests.benchmarks.grey_box [--logs slippery_20hz free_20hz emulated_car] [--seeds 1] [--parameters]

N is the mean over channels of RMSE / standard deviation after 1, 10, 20 and 60 steps. The peer is a bicycle model with
Pacejka tyres, fitted manually to the real cars. Times are processor times; the first fit of a law includes compilation.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np

from evaluation.prediction import PredictionProtocol, assess_model, measured_cases
from model_zoo.grey_box import GreyBox
from sysid_evo.models.base import make_model
from tests.benchmarks.cars import EMULATED, TEST_EPISODE, recording

PEER = {"slippery_20hz": (0.121, 0.38, 0.44, 0.47), "free_20hz": (0.129, 0.29, 0.33, 0.37)}
FAMILIES = {
    "parametrised": {},
    "single_track(tyre=pacejka)": {},
    "single_track(tyre=tanh)": {"tyre": "tanh"},
    "single_track(residual=True)": {"residual": True},
}


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--logs", nargs="+", default=[*TEST_EPISODE, EMULATED], choices=[*TEST_EPISODE, EMULATED])
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--parameters", action="store_true", help="also print the parameters of the first seed")
    arguments = parser.parse_args()
    write = sys.stdout.write
    for log in arguments.logs:
        training, test = recording(log)
        cases = measured_cases(training, test, PredictionProtocol())
        write(f"\n{log}: N after {', '.join(map(str, cases.horizons))} steps, mean of {arguments.seeds} seeds\n")
        if log in PEER:
            write(f"  {'peer: bicycle, Pacejka tyres':30s} {'  '.join(f'{n:.3f}' for n in PEER[log])}\n")
        for label, options in FAMILIES.items():
            rows, seconds = [], []
            for seed in range(arguments.seeds):
                model = make_model(label.split("(")[0], **options)
                began = time.process_time()
                model.fit(training, rng=np.random.default_rng(seed))
                seconds.append(time.process_time() - began)
                scored = assess_model(label, model, cases, family=label)
                rows.append([score.n for horizon in cases.horizons if (score := scored.score(horizon))])
                if seed == 0 and arguments.parameters and isinstance(model, GreyBox):
                    for row in model.parameters_table():
                        mark = "" if row["determined"] else "  not determined"
                        write(f"    {row['parameter']:20s} {row['value']:9.4f} +- {row['standard error']:.4f} ")
                        write(f"{row['unit']}{mark}\n")
                    for sentence in model.undetermined_:
                        write(f"    {sentence}\n")
            figures = "  ".join(f"{n:.3f}" for n in np.mean(rows, axis=0))
            write(f"  {label:30s} {figures}  fit {min(seconds):.1f} s\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
