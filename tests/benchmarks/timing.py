"""Several programs timed in turn in one process, so that a noisy machine affects all of them equally."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Timing:
    """Medians over the repeats, in seconds: of this process on all processors, and on the clock."""

    processor: float
    wall: float


def in_turn(programs: Mapping[str, Callable[[], object]], *, repeats: int, shortest: float) -> dict[str, Timing]:
    """Run every program once to warm up, then all of them in turn, ``repeats`` times.

    A turn calls its program as often as takes ``shortest`` seconds.
    """
    calls = {}
    for name, program in programs.items():
        program()
        began = time.perf_counter()
        program()
        calls[name] = max(1, int(np.ceil(shortest / max(time.perf_counter() - began, 1e-9))))
    taken: dict[str, list[tuple[float, float]]] = {name: [] for name in programs}
    for _ in range(repeats):
        for name, program in programs.items():
            processor, wall = time.process_time(), time.perf_counter()
            for _ in range(calls[name]):
                program()
            n = calls[name]
            taken[name].append(((time.process_time() - processor) / n, (time.perf_counter() - wall) / n))
    return {name: Timing(*np.median(np.array(times), axis=0)) for name, times in taken.items()}
