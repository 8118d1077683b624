"""Measured and expected times of the candidates of `auto`.

    python -m tests.benchmarks.choosing.costs [RECORDING] [--steps STEPS] [--only WORD ...]

Every candidate is fitted twice to the training data of a recording (see `tests.benchmarks.choosing`) in this process:
as it is when it is only judged, and as it is when it is kept. What is measured second is what `Candidate.seconds`
should be about, for 7200 steps of a car. The last two numbers are measured / expected, of both fits: a machine makes
all of them larger or smaller, and where one differs from the others the list is wrong. A first fit of every candidate,
to a tenth of the data, loads what it needs and does not count.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings

import numpy as np

from model_zoo.auto.candidates import SHIPPED, Candidate, unusable
from sysid_evo.data import Dataset
from tests.benchmarks.choosing.__main__ import recording


def seconds(candidate: Candidate, data: Dataset, *, rough: bool) -> float:
    """Return the processor time of a fit, in s."""
    model = candidate.model(**(candidate.selection_settings if rough else {}))
    began = time.process_time()
    model.fit(data, rng=np.random.default_rng(0))
    return time.process_time() - began


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", nargs="?", default="free_20hz")
    parser.add_argument("--steps", type=int, help="of what it learns from, by default all")
    parser.add_argument("--only", nargs="*", default=[])
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    data, _ = recording(arguments.recording)
    if arguments.steps is not None and arguments.steps < data.n_steps:
        data, _ = data.split(1.0 - arguments.steps / data.n_steps)
    system, steps = data.system, data.n_steps
    sys.stdout.write(f"{arguments.recording}: {steps} steps, processor seconds, expected -> measured\n")
    for candidate in SHIPPED:
        if unusable(candidate, system) or not all(word in candidate.name for word in arguments.only):
            continue
        seconds(candidate, data.split(0.9)[0], rough=True)
        told, ratios = [], []
        for rough in (True, False):
            expected = candidate.seconds_for(system, steps, rough=rough)
            found = seconds(candidate, data, rough=rough)
            told.append(f"{expected:6.1f} -> {found:6.1f}")
            ratios.append(found / expected)
        sys.stdout.write(f"  {'   '.join(told)}   x {ratios[0]:4.2f} {ratios[1]:4.2f}  {candidate.name}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
