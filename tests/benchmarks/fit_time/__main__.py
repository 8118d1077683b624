"""Fits families and prints what that costs and how well they then predict: ``python -m tests.benchmarks.fit_time``.

    python -m tests.benchmarks.fit_time [FAMILY ...] [--presets quick standard] [--seeds 3] [--systems emulated_car]
                                        [--data FILE ...] [--before FOLDER]

Every fit has a process of its own and one thread. Systems are emulated robots, which are recorded for six minutes, of
which the last quarter of every episode is held back; the recordings of ``tests.benchmarks.prediction``; and files given
with --data, held back alike. N is the RMSE over the standard deviation, the mean over channels, of free runs over the
held-out part, after 1, 5 and 20 steps and over the whole file.

``--before`` is another checkout of this project, such as the state before a change. Its fits and this one's take turns,
and the last column is before / after: seconds of the processor, and errors paired by seed.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hardware.robot import find_robot
from sysid_evo.data import Dataset
from sysid_evo.errors import IncompatibleSystem
from sysid_evo.registry import make_model, models
from tests.benchmarks.fit_time.one_fit import HORIZONS
from tests.benchmarks.prediction import HELD_BACK, RECORDED_TIME, TEST_EPISODE, recording

HERE = Path(__file__).parents[3]
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
Outcome = dict[str, Any]


def recorded(name: str) -> tuple[Dataset, Dataset]:
    """Return training and test set of a robot, of a known recording, or of a file."""
    if name in TEST_EPISODE:
        return recording(name)
    if Path(name).exists():
        return Dataset.read(name).split(HELD_BACK)
    return find_robot(name).record(seed=0, duration=RECORDED_TIME).dataset.split(HELD_BACK)


def fitted(checkout: Path, folder: Path, family: str, preset: str, seed: int) -> Outcome:
    """Return what one fit by ``checkout`` costs and how far off it is. Raises `RuntimeError` if it fails."""
    script = Path(__file__).with_name("one_fit.py")
    command: list[str | Path] = [
        sys.executable,
        script,
        folder / "training",
        folder / "test",
        family,
        preset,
        str(seed),
    ]
    environment = {**os.environ, **ONE_THREAD, "PYTHONPATH": str(checkout)}
    done = subprocess.run(command, cwd=checkout, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{family} in {checkout}: {done.stderr.strip().splitlines()[-1]}")
    found: Outcome = json.loads(done.stdout.strip().splitlines()[-1])
    return found


def line(label: str, outcomes: Sequence[Outcome]) -> str:
    """Return one row of the table: medians of seconds, means of errors."""
    processor, wall, silent = (np.median([o[key] for o in outcomes]) for key in ("processor", "wall", "silent"))
    errors = np.mean([o["errors"] for o in outcomes], axis=0)
    lags = " ".join(sorted({",".join(map(str, o["lags"])) for o in outcomes}))
    figures = "  ".join(f"{error:7.4f}" for error in errors)
    return f"  {label:28s} {processor:7.2f} s  {wall:7.2f} s  {silent:4.1f} s   {figures}   {lags}\n"


def compared(before: Sequence[Outcome], after: Sequence[Outcome]) -> str:
    """Return the row of ratios: seconds before / after, and the paired differences of the errors with their spread."""
    gain = [b["processor"] / a["processor"] for b, a in zip(before, after, strict=True)]
    relative = np.array([a["errors"] for a in after]) / np.array([b["errors"] for b in before]) - 1.0
    figures = "  ".join(
        f"{100 * mean:+5.1f}±{100 * deviation:.1f}%"
        for mean, deviation in zip(relative.mean(axis=0), relative.std(axis=0), strict=True)
    )
    return (
        f"  {'  before / after':28s} {np.median(gain):7.2f} x  ({min(gain):.2f} - {max(gain):.2f})        {figures}\n"
    )


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("families", nargs="*", help="default: every registered family")
    parser.add_argument("--presets", nargs="+", default=["standard"])
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--systems", nargs="*", default=["emulated_car"])
    parser.add_argument("--data", nargs="*", default=[], help="recordings in files")
    parser.add_argument("--before", type=Path, help="another checkout, to compare with")
    arguments = parser.parse_args()
    write = sys.stdout.write
    steps = ", ".join(map(str, HORIZONS))
    checkouts = [HERE] if arguments.before is None else [arguments.before.resolve(), HERE]
    for system in [*arguments.systems, *arguments.data]:
        training, test = recorded(system)
        write(f"\n{system}: processor, wall and longest silence (median of {arguments.seeds}); ")
        write(f"N after {steps} steps and over the whole file (mean); lags\n")
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            training.save(folder / "training")
            test.save(folder / "test")
            for family in arguments.families or models.names():
                try:
                    make_model(family).check_system(training.system)
                except IncompatibleSystem:
                    continue
                for preset in arguments.presets:
                    found: dict[Path, list[Outcome]] = {checkout: [] for checkout in checkouts}
                    for seed in range(arguments.seeds):
                        for checkout in checkouts:
                            found[checkout].append(fitted(checkout, folder, family, preset, seed))
                    for checkout, outcomes in found.items():
                        when = "before" if checkout != HERE else "after" if len(found) > 1 else ""
                        write(line(f"{family} {preset} {when}", outcomes))
                    if len(found) > 1:
                        write(compared(*found.values()))
                    sys.stdout.flush()


if __name__ == "__main__":
    main()
