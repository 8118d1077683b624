"""Fits the whole zoo once and prints how long each family took: ``python -m tests.benchmarks.fit_time``.

    python -m tests.benchmarks.fit_time [FAMILY ...] [--log slippery_20hz] [--preset standard]

Families are fitted one after the other, on as many threads as each takes by itself. ``silent`` is the
longest time without a word of progress, which is how long Ctrl-C from a progress bar may have to wait.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np

from evaluation.comparison.model_cells import with_preset
from sysid_evo.registry import Spec, make_model, models
from tests.benchmarks.prediction import EMULATED, TEST_EPISODE, recording


class Silence:
    """A `Progress` that measures the longest time between two calls."""

    def __init__(self) -> None:
        self.last = time.perf_counter()
        self.longest = 0.0

    def __call__(self, done: int, total: int) -> None:
        now = time.perf_counter()
        self.longest, self.last = max(self.longest, now - self.last), now


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("families", nargs="*", help="default: every registered family")
    parser.add_argument("--preset", default="standard")
    parser.add_argument("--log", default="slippery_20hz", choices=[*TEST_EPISODE, EMULATED])
    arguments = parser.parse_args()
    training, _ = recording(arguments.log)
    write = sys.stdout.write
    write(f"{arguments.log}, preset {arguments.preset}: seconds of each fit, and the longest silence\n")
    all_seconds = 0.0
    for name in arguments.families or models.names():
        model, silence = make_model(with_preset(Spec(name), arguments.preset)), Silence()
        began = time.perf_counter()
        model.fit(training, rng=np.random.default_rng(0), progress=silence)
        seconds = time.perf_counter() - began
        all_seconds += seconds
        write(f"  {name:20s} {seconds:6.1f} s   silent {silence.longest:4.1f} s\n")
        sys.stdout.flush()
    write(f"  {'all':20s} {all_seconds:6.1f} s\n")


if __name__ == "__main__":
    main()
