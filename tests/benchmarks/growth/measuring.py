"""Cost and memory of one thing at growing sizes, and the slope of both on log axes."""

from __future__ import annotations

import json
import subprocess
import sys
import time
import tracemalloc
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from sysid_evo.errors import DataWarning

UPPER = 10.0
"""The slope is that of the sizes from a tenth of the largest on, at least three."""

WORSE = 1.15
"""A slope from here on is worse than linear."""

SHORTEST = 0.02
"""Processor seconds that one timing lasts at least; what is quicker is repeated."""

LONG = 1.0
"""Processor seconds from which on a program is run twice."""


@dataclass(frozen=True)
class Growth:
    """A measurement along one axis: ``make(size)`` prepares a program, which is then timed.

    ``best`` is the possible slope, by default 1. With ``command`` the program of a size runs as a separate process with
    these arguments, and its peak resident memory is measured; otherwise the peak allocation of Python and NumPy.
    """

    part: str
    name: str
    axis: str
    sizes: tuple[int, ...]
    make: Callable[[int], Callable[[], object]] | None = None
    command: Callable[[int], Sequence[str]] | None = None
    best: float = 1.0


@dataclass
class Curve:
    """Processor seconds and megabytes at each of the ``sizes`` that were reached."""

    growth: Growth
    sizes: list[int] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    megabytes: list[float] = field(default_factory=list)

    @property
    def slope(self) -> float:
        """Slope of the cost on log axes, nan with fewer than two sizes."""
        return slope(self.sizes, self.seconds)

    @property
    def memory_slope(self) -> float:
        """Slope of the memory on log axes."""
        return slope(self.sizes, self.megabytes)


def slope(sizes: Sequence[float], values: Sequence[float]) -> float:
    """Return the slope of ``values`` on log axes over the upper part of the range."""
    x, y = np.asarray(sizes, dtype=np.float64), np.asarray(values, dtype=np.float64)
    upper = np.flatnonzero(x >= x[-1] / UPPER) if len(x) else np.empty(0, dtype=int)
    upper = upper if len(upper) >= 3 else np.arange(max(0, len(x) - 3), len(x))
    if len(upper) < 2 or not (y[upper] > 0.0).all():
        return float("nan")
    return float(np.polyfit(np.log(x[upper]), np.log(y[upper]), 1)[0])


def measured(growth: Growth, *, rounds: int, most_seconds: float, memory: bool) -> Curve:
    """Time all sizes in turn, ``rounds`` times, and keep the least; sizes after one over ``most_seconds`` are left out.

    A command runs once at each size, what takes longer than `LONG` twice.
    """
    curve = Curve(growth)
    if growth.command is not None:
        for size in growth.sizes:
            seconds, megabytes = of_process(growth.command(size))
            curve.sizes.append(size)
            curve.seconds.append(seconds)
            curve.megabytes.append(megabytes)
            if seconds > most_seconds:
                break
        return curve
    assert growth.make is not None
    programs: list[Callable[[], object]] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataWarning)
        for size in growth.sizes:
            program = growth.make(size)
            if not programs:
                program()  # compiles
            programs.append(program)
            curve.sizes.append(size)
            began = time.process_time()
            program()
            curve.seconds.append(time.process_time() - began)
            if curve.seconds[-1] > most_seconds:
                break
        for number in range(rounds):
            for i, program in enumerate(programs):
                if number == 0 or curve.seconds[i] < LONG:  # the first run may have compiled, or built what is kept
                    curve.seconds[i] = min(curve.seconds[i], timed(program))
        if memory:
            curve.megabytes = [allocated(program) for program in programs]
    return curve


def timed(program: Callable[[], object]) -> float:
    """Return the processor seconds of one run, the mean of as many as last long enough to be timed."""
    began, runs = time.process_time(), 0
    while True:
        program()
        runs += 1
        spent = time.process_time() - began
        if spent >= SHORTEST:
            return spent / runs


def allocated(program: Callable[[], object]) -> float:
    """Return the megabytes that Python and NumPy allocate at most, at the same time, in one run."""
    tracemalloc.start()
    try:
        program()
        return tracemalloc.get_traced_memory()[1] / 2**20
    finally:
        tracemalloc.stop()


def of_process(arguments: Sequence[str]) -> tuple[float, float]:
    """Return processor seconds and the peak of resident memory in megabytes of ``sysid-evo`` with these arguments."""
    code = f"import sys; sys.argv = ['sysid-evo', *{list(arguments)!r}]; from sysid_evo.__main__ import main; main()"
    watch = (
        "import json, resource, subprocess, sys; "
        "subprocess.run([sys.executable, '-c', sys.argv[1]], check=True, stdout=subprocess.DEVNULL, "
        "stderr=subprocess.DEVNULL); used = resource.getrusage(resource.RUSAGE_CHILDREN); "
        "print(json.dumps([used.ru_utime + used.ru_stime, used.ru_maxrss]))"
    )
    printed = subprocess.run([sys.executable, "-c", watch, code], check=True, capture_output=True, text=True).stdout
    seconds, kilobytes = json.loads(printed.strip().splitlines()[-1])
    return float(seconds), kilobytes / 2**10


def doubled(first: int, last: int, factor: int = 2) -> tuple[int, ...]:
    """Return the geometric sequence from ``first`` by the factor, up to ``last``."""

    def values() -> Iterator[int]:
        size = first
        while size <= last:
            yield size
            size *= factor

    return tuple(values())
