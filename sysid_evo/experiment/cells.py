"""A run is a list of cells: each is done once, and one that fails is a row with its reason."""

from __future__ import annotations

import time
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from sysid_evo.errors import SysidEvoError
from sysid_evo.progress import Progress
from sysid_evo.store import RunFolder

T = TypeVar("T")


class Observer(Protocol):
    """Is told what a run is doing; the command line draws progress bars from it."""

    def start(self, cell: str) -> None:
        """``cell`` begins."""

    def progress(self, cell: str, done: int, total: int) -> None:
        """``cell`` has done so many of its steps."""

    def finish(self, cell: str, *, cached: bool, reason: str | None) -> None:
        """``cell`` is done, was done before (``cached``), or failed for ``reason``."""


class Silent:
    """An observer that does nothing."""

    def start(self, cell: str) -> None:
        pass

    def progress(self, cell: str, done: int, total: int) -> None:
        pass

    def finish(self, cell: str, *, cached: bool, reason: str | None) -> None:
        pass


@dataclass(frozen=True)
class Outcome(Generic[T]):
    """What a cell gave: a value, or None and the reason; and the seconds it took when it was computed."""

    value: T | None
    reason: str | None
    seconds: float


def run_cell(
    run: RunFolder,
    cell: str,
    *,
    load: Callable[[], T] | None,
    work: Callable[[Progress], T],
    save: Callable[[T], object],
    observer: Observer,
) -> Outcome[T]:
    """Return the value of ``cell``: from ``load`` if the run has it done, else from ``work``.

    Without ``load`` it is always computed. A cell that fails is recorded with its reason and
    tried again the next time.
    """
    known = run.cells().get(cell)
    if load is not None and known is not None and known["status"] == "done":
        value = load()
        observer.finish(cell, cached=True, reason=None)
        return Outcome(value, None, float(known["timings"]["seconds"]))
    observer.start(cell)
    began = time.perf_counter()
    try:
        value = work(lambda done, total: observer.progress(cell, done, total))
        save(value)
    except Exception as error:  # whatever a plugin does, the other cells go on
        reason = str(error) if isinstance(error, SysidEvoError) else f"{type(error).__name__}: {error}"
        seconds = time.perf_counter() - began
        run.record(cell, seconds=seconds, reason=reason)
        observer.finish(cell, cached=False, reason=reason)
        return Outcome(None, reason, seconds)
    seconds = time.perf_counter() - began
    run.record(cell, seconds=seconds)
    observer.finish(cell, cached=False, reason=None)
    return Outcome(value, None, seconds)


def cell_seed(seed: int, cell: str) -> int:
    """Return the seed of ``cell``: it depends on the run's seed and the cell's name, not on its place."""
    key = zlib.crc32(cell.encode())
    return int(np.random.SeedSequence(seed, spawn_key=(key,)).generate_state(1, np.uint32)[0])
