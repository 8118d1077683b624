"""Number of processors of this process, threads of libraries, default engine."""

from __future__ import annotations

import mmap
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal, TypeAlias

from threadpoolctl import ThreadpoolController

from sysid_evo.errors import InvalidArgument

INNER_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
"""Libraries use one thread, because matrices are small and the engine distributes its blocks over all processors.
They read these variables when they are imported."""


class _Share:
    """The number of processors of this process, one of several ``counts``; 0 for all available ones."""

    counts = memoryview(bytearray(2)).cast("H")
    place = 0


def available_processors() -> int:
    """Return the number of processors that this process may use, its share if it has one."""
    return _Share.counts[_Share.place] or usable_processors()


def usable_processors() -> int:
    """Return the number of processors on which the operating system runs this process."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def use_processors(count: int) -> None:
    """Use ``count`` processors in this process from now on; 0 for all. Results do not depend on it."""
    _Share.counts, _Share.place = memoryview(bytearray(2)).cast("H"), 0
    _Share.counts[0] = count


def shared_counts(file: Path) -> memoryview:
    """Return the 16-bit numbers in ``file``, as memory shared between processes."""
    with file.open("r+b") as stream:
        return memoryview(mmap.mmap(stream.fileno(), 0)).cast("H")


def use_shared_count(file: Path, place: int) -> None:
    """Use as many processors in this process as the current number at ``place`` in ``file``."""
    _Share.counts, _Share.place = shared_counts(file), place


class _LinearAlgebra:
    """The libraries of linear algebra, and the number of modules when they were searched."""

    modules = 0
    found: ThreadpoolController


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Run linear algebra on one thread in this context, except in torch, see `one_thread`.

    With several threads sums are rounded differently, and small matrices take many times as long on a busy machine.
    """
    if len(sys.modules) != _LinearAlgebra.modules:  # libraries are added by imports only; a search takes 6 ms
        _LinearAlgebra.found, _LinearAlgebra.modules = ThreadpoolController(), len(sys.modules)
    with _LinearAlgebra.found.limit(limits=1, user_api="blas"):
        yield


@contextmanager
def one_thread(seed: int) -> Iterator[None]:
    """Run torch on one thread with random numbers from ``seed`` in this context, and restore its state."""
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            yield
    finally:
        torch.set_num_threads(threads)


Engine: TypeAlias = Literal["auto", "reference", "float32", "float64"]
ENGINE_VARIABLE = "SYSID_EVO_ENGINE"


def resolve(requested: Engine = "auto") -> Engine:
    """Return ``requested``, or for "auto" the engine in the variable `SYSID_EVO_ENGINE`, if it is set.

    "auto": compiled where there are kernels, else NumPy. "reference": NumPy in rollouts, imagined trials, parameter
    evolution and the fit of grey boxes. Simulations and sensitivities in the training of state spaces have no NumPy
    form and are always compiled. Raises `InvalidArgument` for other values.
    """
    named = os.environ.get(ENGINE_VARIABLE) or "auto"
    if requested != "auto" or named == "auto":
        return requested
    if named != "reference":
        raise InvalidArgument(f"{ENGINE_VARIABLE}: expected auto or reference, got {named!r}. Set one, or unset it")
    return "reference"


def engine_inputs() -> dict[str, Engine]:
    """Return the entry of digests for the engine; empty for "auto", so that stored results are found."""
    return {} if (engine := resolve()) == "auto" else {"engine": engine}
