"""How fast rollouts are on a CUDA device: ``python -m tests.benchmarks.cuda``.

For every model: million steps a second of the closed loop with the paper's controller and task, from 1e3 to 1e6
rollouts at once, by the clock of the program alone and of the whole call with everything that is sent and read; beside
it the processor with all its cores, and from how many rollouts on the device is faster. The share
of the device is that of its multiply-add limit: operations of a step, counted, over two for each core and tick.
Ends with 300 generations of a population of 10,000, on the device and on the processor (a few of them, multiplied).
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from rich.console import Console
from rich.table import Table

from sysid_evo.arrays import Array
from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.dynamics import Dynamics
from sysid_evo.engine import DynamicsRunner, Engine, rollout
from sysid_evo.engine.cuda import device
from sysid_evo.errors import MissingExtra, NoDevice
from sysid_evo.evolution import EnsembleObjective, MuPlusLambda, evolve
from sysid_evo.randomness import trial_seeds
from sysid_evo.tasks import PointToPoint
from tests.benchmarks.c_reference import models
from tests.benchmarks.cuda.operations import per_step

TRIALS = 10
ROLLOUTS = (1_000, 10_000, 100_000, 1_000_000)
GENERATIONS, POPULATION = 300, 10_000
CORES_OF_A_MULTIPROCESSOR = 128


def limit() -> tuple[str, float]:
    """Return what the device is called, and how many operations a second (two in each multiply-add) it can do."""
    from numba import cuda

    there: Any = cuda.get_current_device()
    ticks = there.MULTIPROCESSOR_COUNT * there.CLOCK_RATE * 1e3
    name = there.name.decode() if isinstance(there.name, bytes) else str(there.name)
    return name, 2.0 * CORES_OF_A_MULTIPROCESSOR * ticks


class Timed:
    """A program of the device that adds the seconds that it takes itself to ``seconds``."""

    seconds = 0.0

    def __init__(self, entry: Any) -> None:
        self.entry = entry

    def __getitem__(self, configuration: Any) -> Callable[..., None]:
        """Return the program as it is launched."""

        def launch(*arguments: Any) -> None:
            from numba import cuda

            cuda.synchronize()
            began = time.perf_counter()
            self.entry[configuration](*arguments)
            cuda.synchronize()
            Timed.seconds += time.perf_counter() - began

        return launch


def timed(
    dynamics: Dynamics, population: Array, task: PointToPoint, engine: Engine, repeats: int
) -> tuple[float, float]:
    """Return million steps a second of the program of the device alone (0 on a processor), and of the whole call."""
    from sysid_evo.engine.cuda import program

    compiled, seeds = program.compiled, trial_seeds(1, TRIALS, generation=9)
    run, alone, whole = None, [], []
    with mock.patch.object(program, "compiled", lambda *given: Timed(compiled(*given))):
        for _ in range(repeats + 1):  # the first compiles
            Timed.seconds, began = 0.0, time.perf_counter()
            run = rollout(dynamics, RecurrentNetwork(), population, task, seeds, engine=engine)
            whole.append(time.perf_counter() - began)
            alone.append(Timed.seconds)
    assert run is not None
    steps = float(run.survived.sum()) / 1e6
    of_device = float(np.median(alone[1:]))
    return steps / of_device if of_device else 0.0, steps / float(np.median(whole[1:]))


def of_model(name: str, folder: Path, repeats: int, largest: int, peak: float) -> dict[str, Any]:
    """Return a row: speeds by rollouts, the crossover and the share of the limit."""
    dynamics, task = models.dynamics(name, folder), PointToPoint()
    some = models.population(name, dynamics, folder)
    kernel = dynamics.kernel()
    precision: Engine = "float32" if kernel is None else kernel.precision
    speeds, crossover = {}, None
    processor = timed(dynamics, some, task, precision, 1)[1]
    for rollouts in [count for count in ROLLOUTS if count <= largest]:
        population = np.tile(some, (-(-rollouts // TRIALS // len(some)), 1))[: rollouts // TRIALS]
        alone, whole = timed(dynamics, population, task, "cuda", repeats)
        speeds[rollouts] = {"device": alone, "call": whole}
        crossover = rollouts if crossover is None and whole > processor else crossover
    operations = per_step(dynamics, RecurrentNetwork(), some[0], PointToPoint(horizon=20))
    best = max(speed["device"] for speed in speeds.values())
    return {
        "model": name,
        "million_steps_per_second": speeds,
        "processor": processor,
        "faster_from": crossover,
        "operations_per_step": operations,
        "share_of_limit": best * 1e6 * operations / peak,
    }


def generations(dynamics: Dynamics, engine: Engine, count: int) -> float:
    """Return the seconds of ``count`` generations of a population of 10,000 in ten trials each, after one."""
    half = POPULATION // 2
    strategy = MuPlusLambda(n_parameters=models.N_PARAMETERS, seed=1, parents=half, children=POPULATION - half)
    objective = EnsembleObjective((DynamicsRunner(dynamics, engine),), RecurrentNetwork(), PointToPoint(), 1, TRIALS)
    steps = evolve(strategy, objective, count + 1)
    next(steps)
    began = time.perf_counter()
    for _ in steps:
        pass
    return time.perf_counter() - began


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and print, or say that there is no device."""
    parser = argparse.ArgumentParser(prog="tests.benchmarks.cuda", description=__doc__)
    parser.add_argument("--models", nargs="*", default=[*models.FAMILIES, models.CAR])
    parser.add_argument("--folder", type=Path, default=Path("runs/cuda-benchmark"), help="where fitted models are kept")
    parser.add_argument("--largest", type=int, default=ROLLOUTS[-1], help="of the numbers of rollouts")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--generations", type=int, default=GENERATIONS, help="of the population of 10,000; 0: none")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    chosen = parser.parse_args(arguments)
    console = Console()
    try:
        device.check()
    except (MissingExtra, NoDevice) as error:
        console.print(f"Nothing was measured: {error}", markup=False)
        return
    name, peak = limit()
    chosen.folder.mkdir(parents=True, exist_ok=True)
    table = Table("model", *(f"{count:.0e}" for count in ROLLOUTS), "processor", "faster from", "of the limit")
    rows = []
    for model in chosen.models:
        rows.append(of_model(model, chosen.folder, chosen.repeats, chosen.largest, peak))
        speeds = rows[-1]["million_steps_per_second"]
        cells = [
            f"{speeds[count]['device']:.0f} / {speeds[count]['call']:.0f}" if count in speeds else ""
            for count in ROLLOUTS
        ]
        found = rows[-1]
        table.add_row(
            model, *cells, f"{found['processor']:.0f}", f"{found['faster_from']}", f"{found['share_of_limit']:.1%}"
        )
    console.print(table)
    console.print(
        f"{name}, limit {peak / 1e12:.1f} T operations/s. Million steps a second by rollouts at once: the program "
        f"alone / the whole call. `auto` takes the device from {device.ENOUGH} rollouts on.",
        markup=False,
    )
    report = {"device": name, "peak": peak, "models": rows}
    if chosen.generations:
        dynamics, few = models.dynamics(chosen.models[0], chosen.folder), 3
        seconds = {
            "cuda": generations(dynamics, "cuda", chosen.generations),
            "float32": generations(dynamics, "float32", few) * chosen.generations / few,
        }
        console.print(
            f"{chosen.generations} generations of {POPULATION} on {chosen.models[0]}: {seconds['cuda']:.1f} s on the "
            f"device, {seconds['float32']:.1f} s on the processor ({few} of them, multiplied)."
        )
        report["generations"] = seconds
    if chosen.json is not None:
        chosen.json.write_text(json.dumps(report, indent=1))


if __name__ == "__main__":
    main()
