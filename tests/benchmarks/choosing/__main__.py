"""Compares `auto` with published results of peers and with every single candidate, in hindsight.

    python -m tests.benchmarks.choosing [RECORDING ...] [--preset standard] [--seeds 3] [--alone 1] [--keep FOLDER]

RECORDING is one of the two real cars (slippery_20hz, free_20hz); a drive of a third on one of four floors (DS1, DS3,
DS4, DS5), the last 30 % held out; an emulated robot (emulated_car, pendulum, cart_pole, thermal); or a system of
`tests.benchmarks.choosing.systems` (own_cart_pole, hover_channel). Simulated systems are recorded for six minutes, and
again for the test. N is RMSE / standard deviation, averaged over states, after 1, 10, 20 and 60 steps.

The table begins with `auto` and its note for each seed, and the processor time of all its fits. Then follows, for
``--alone`` seeds (0: none), every candidate fitted alone to the same data; the best in hindsight has the lowest N after
20 steps. A difference is marked if its 95 % interval (paired block bootstrap, pooled over the seeds) excludes zero.
With ``--keep`` fitted models are stored in a folder and reused; ``--seeds 0`` fits the candidates only.
The last table has all recordings, after 10, 20 and 60 steps.
"""

from __future__ import annotations

import argparse
import os
import resource
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import psutil
from rich.console import Console
from rich.table import Table

from evaluation.chosen_models import with_preset
from evaluation.prediction.cases import MeasuredCases, PredictionProtocol, measured_cases
from evaluation.prediction.scores import ModelPrediction
from evaluation.prediction.scoring import assess_model
from model_zoo.auto.candidates import SHIPPED, unusable
from sysid_evo.data import Dataset
from sysid_evo.models import DynamicsModel, load_model, save_model
from sysid_evo.models.base import make_model
from sysid_evo.registry import Spec, make_robot
from tests.benchmarks.cars import SECOND, TEST_EPISODE, pooled
from tests.benchmarks.cars import recording as car_recording
from tests.benchmarks.choosing.systems import SIMULATED
from tests.benchmarks.markdown import add_markdown, print_tables, thousandths

PEERS = {"slippery_20hz": {10: 0.266, 20: 0.296, 60: 0.305}, "free_20hz": {10: 0.192, 20: 0.204, 60: 0.212}}
"""The lowest N of any peer at each horizon, under the same rules."""
HORIZONS = (10, 20, 60)
"""Those of the peers, in steps."""
ROBOTS = ("emulated_car", "pendulum", "cart_pole", "thermal")
FLOORS = ("DS1", "DS3", "DS4", "DS5")
RECORDED_TIME, TESTED_TIME = 360.0, 720.0
LAST_OF_A_DRIVE = 0.3


def recording(name: str) -> tuple[Dataset, Dataset]:
    """Return training and test set of a real car, of an emulated robot, or of a system simulated here."""
    if name in TEST_EPISODE:
        return car_recording(name)
    if name in FLOORS:
        root = Path(os.environ.get("SYSID_EVO_DATA", Path(__file__).parents[3].parent / "shared" / "data"))
        return Dataset.read(root / "f1tenth_frictionmaps" / f"{name}_20hz.csv").split(LAST_OF_A_DRIVE)
    if name in SIMULATED:
        return SIMULATED[name]().recording(seed=0), SIMULATED[name]().recording(seed=1)
    robot = make_robot(name)
    training, test = robot.record(seed=0, duration=RECORDED_TIME), robot.record(seed=1, duration=TESTED_TIME)
    return training.dataset, test.dataset


class Fits:
    """Fitted models of one recording, stored in a folder if there is one."""

    def __init__(self, name: str, folder: Path | None) -> None:
        self.name, self.folder = name, folder
        self.training, test = recording(name)
        self.cases: MeasuredCases = measured_cases(self.training, test, PredictionProtocol())

    def score(self, spec: Spec, seed: int) -> tuple[ModelPrediction, DynamicsModel, str]:
        """Return the prediction errors of a family fitted with this seed, the model, and the time of the fit."""
        file = None if self.folder is None else self.folder / f"{self.name}-{seed}-{_as_file_name(spec)}"
        if file is not None and file.with_name(f"{file.name}.json").is_file():
            model, took = load_model(file.with_name(f"{file.name}.json")), "kept"
        else:
            began, used = time.perf_counter(), processor_seconds()
            model = make_model(spec).fit(self.training, rng=np.random.default_rng(seed))
            took = f"{time.perf_counter() - began:.0f} s, {processor_seconds() - used:.0f} s of processors"
            if file is not None:
                save_model(model, file, seed=seed)
        return assess_model(f"{spec}-{seed}", model, self.cases, family=spec.name), model, took


def processor_seconds() -> float:
    """Return the processor time of this process and of all processes that it has started, running or ended."""
    own, ended = psutil.Process(), resource.getrusage(resource.RUSAGE_CHILDREN)
    every = [own.cpu_times(), *(child.cpu_times() for child in own.children(recursive=True))]
    return float(sum(times.user + times.system for times in every) + ended.ru_utime + ended.ru_stime)


def _as_file_name(spec: Spec) -> str:
    return "".join(letter if letter.isalnum() or letter in "._" else "-" for letter in spec.text.replace(" ", ""))


def difference(first: list[ModelPrediction], second: list[ModelPrediction], horizon: int) -> str:
    """Return the difference of the errors (first minus second) at a horizon, marked if it is significant."""
    own, other = pooled(first, horizon), pooled(second, horizon)
    mark = " *" if (own - other).estimate.differs_from(0.0) else ""
    return f"{100.0 * (own.value / other.value - 1.0):+.1f} %{mark}"


def benchmark(name: str, preset: str, seeds: int, alone: int, folder: Path | None) -> tuple[str, str, str, str]:
    """Write the errors of `auto` and of every single candidate on one recording.

    Return the row of the table, with `HORIZONS`.
    """
    write, fits = sys.stdout.write, Fits(name, folder)
    horizons = [horizon for horizon in fits.cases.horizons if horizon is not None]
    write(f"\n{name}: N after {', '.join(map(str, horizons))} steps\n")

    def line(rows: list[ModelPrediction], shown: Sequence[int] = horizons) -> str:
        return thousandths(pooled(rows, horizon).value for horizon in shown)

    auto = with_preset(Spec("auto"), preset)
    found = []
    for seed in range(seeds):
        row, model, took = fits.score(auto, seed)
        found.append(row)
        write(f"  auto, {preset}, seed {seed}:  {line([row])}  ({took})\n    {model.fit_note}\n")
        sys.stdout.flush()
    if found:
        write(f"  auto, mean of {seeds} seeds:  {line(found)}\n")
    for horizon, peer in PEERS.get(name, {}).items() if found else ():
        own = pooled(found, horizon).value
        write(f"    after {horizon} steps {own:.3f}, the best peer {peer:.3f}: {100.0 * (own / peer - 1.0):+.1f} %\n")
    rivals: dict[str, list[ModelPrediction]] = {}
    for candidate in SHIPPED if alone else ():
        if not unusable(candidate, fits.training.system):
            rivals[candidate.name] = [fits.score(candidate.spec, seed)[0] for seed in range(alone)]
            write(f"  {line(rivals[candidate.name])}  {candidate.name}\n")
            sys.stdout.flush()
    best = min(rivals, key=lambda one: pooled(rivals[one], SECOND).value) if rivals else None
    if best is not None and found:
        told = ", ".join(f"{horizon}: {difference(found, rivals[best], horizon)}" for horizon in horizons)
        write(f"  auto against the best alone in hindsight, {best}: {told}\n")
    return (
        f"{name}, `{preset}`",
        line(found, HORIZONS) if found else "",
        thousandths(PEERS.get(name, {}).values()),
        "" if best is None else line(rivals[best], HORIZONS),
    )


def main(arguments: list[str] | None = None) -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "recordings", nargs="*", metavar="RECORDING", help=", ".join([*TEST_EPISODE, *FLOORS, *ROBOTS, *SIMULATED])
    )
    parser.add_argument("--preset", nargs="+", default=["standard"], help="one or more")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--alone", type=int, default=1)
    parser.add_argument("--keep", type=Path)
    add_markdown(parser)
    given = parser.parse_args(arguments)
    table = Table("recording", "`auto`", "best peer at each horizon", "best single candidate, in hindsight")
    for name in given.recordings or TEST_EPISODE:
        for preset in given.preset:
            table.add_row(*benchmark(name, preset, given.seeds, given.alone, given.keep))
    print_tables([table], given.markdown, Console(width=120))


if __name__ == "__main__":
    main()
