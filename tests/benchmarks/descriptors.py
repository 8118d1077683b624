"""What the descriptors of behaviour cost in the engine: ``python -m tests.benchmarks.descriptors``.

A population of 100 evolved controllers is rolled out in 10 trials by the fast engine on one thread, for each model of
`tests.benchmarks.rollout` and the emulated car, by the loop as it is and by the same loop in which nobody counts, in
turn and in one process. Prints processor time of both and the share that counting takes, medians over the turns;
``--most`` (3) is the share in percent above which it ends with 1.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any
from unittest import mock

import numpy as np
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from sysid_evo.arrays import Array, BoolArray, IntArray
from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.engine import behaviour, rollout
from sysid_evo.engine.compiled import loops, run
from sysid_evo.engine.compiled.dialect import KernelSource, Precision, compile_kernel
from sysid_evo.randomness import trial_seeds
from sysid_evo.tasks import PointToPoint
from tests.benchmarks.rollout.__main__ import LATER, SEED, TRIALS, evolved
from tests.benchmarks.rollout.families import Case, cases, recording
from tests.benchmarks.rollout.timing import in_turn

CANDIDATES, GENERATIONS = 100, 30
SHORTEST = 0.1  # s that a turn lasts at least
AS_IT_IS, UNCOUNTED = "as it is", "nobody counts"


def nothing(values, alive, centre, rows, tally):  # type: ignore[no-untyped-def]  # a kernel function
    """Stand for `loops.count_sides` and count nothing."""
    tally[0] = 0.0


def none_of(counts: Array, survived: IntArray, diverged: BoolArray) -> Array:
    """Stand for `behaviour.shares` and divide nothing."""
    return counts


@cache
def uncounting_loop(precision: Precision) -> Any:
    """Return the closed loop of the engine, compiled, with nobody who counts."""
    source = KernelSource(loops.closed_loop, {"count_sides": nothing})
    return compile_kernel(source, loops.CLOSED_LOOP, precision, pointer=False)


@contextmanager
def uncounted() -> Iterator[None]:
    """Let the fast engine count nothing while the work inside goes on."""
    with (
        mock.patch.object(run, "closed_loop", uncounting_loop),
        mock.patch.object(behaviour, "shares", none_of),
    ):
        yield


def costs(case: Case, *, candidates: int, generations: int, repeats: int, horizon: int) -> dict[str, float]:
    """Return the processor seconds of rolling out a population once, as it is and without counting."""
    task, seeds = PointToPoint(horizon=horizon), trial_seeds(SEED, TRIALS, generation=LATER)
    population = evolved(case.dynamics, task, candidates, generations)

    def fast() -> Array:
        return rollout(
            case.dynamics, RecurrentNetwork(), population, task, seeds, engine="float32", threads=1
        ).behaviour

    def without() -> Array:
        with uncounted():
            return fast()

    assert np.any(fast())
    assert not np.any(without())
    timings = in_turn({AS_IT_IS: fast, UNCOUNTED: without}, repeats=repeats, shortest=SHORTEST)
    return {name: timing.processor for name, timing in timings.items()}


def main(arguments: list[str] | None = None) -> int:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(prog="tests.benchmarks.descriptors", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="small populations and one turn: does it run?")
    parser.add_argument("--models", nargs="*", default=[], help="only models whose names contain one of these")
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--most", type=float, default=3.0)
    given = parser.parse_args(arguments)
    candidates, generations, repeats = (10, 2, 1) if given.quick else (CANDIDATES, GENERATIONS, given.repeats)
    horizon = 50 if given.quick else 500
    table, shares = Table(title=f"{candidates} candidates, {TRIALS} trials, one thread"), []
    for number, name in enumerate(("model", f"{AS_IT_IS}, ms", f"{UNCOUNTED}, ms", "counting")):
        table.add_column(name, justify="right" if number else "left")
    with threadpool_limits(1):
        for case in cases(recording(episodes=2 if given.quick else 12, steps=600), generations=5):
            if given.models and not any(part in case.name for part in given.models):
                continue
            found = costs(case, candidates=candidates, generations=generations, repeats=repeats, horizon=horizon)
            shares.append(100.0 * (1.0 - found[UNCOUNTED] / found[AS_IT_IS]))
            table.add_row(case.name, *(f"{1e3 * seconds:.2f}" for seconds in found.values()), f"{shares[-1]:.1f} %")
    Console(width=80).print(table)
    return 1 if max(shares) > given.most and not given.quick else 0


if __name__ == "__main__":
    sys.exit(main())
