"""What this process computes with: how many processors, and which form of the engine where none is named."""

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
"""Libraries work on one thread: the matrices are small, and the engine spreads its blocks over all processors.
They read these variables when they are imported."""


class _Share:
    """How many of the processors were given to this process: one of several ``counts``; 0 for all that it may use."""

    counts = memoryview(bytearray(2)).cast("H")
    place = 0


def available_processors() -> int:
    """Return how many processors this process may use: its share, if it was given one."""
    return _Share.counts[_Share.place] or usable_processors()


def usable_processors() -> int:
    """Return on how many processors the system lets this process run."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def use_processors(count: int) -> None:
    """Let what begins from now on in this process use ``count`` processors; 0 for all. No result depends on it."""
    _Share.counts, _Share.place = memoryview(bytearray(2)).cast("H"), 0
    _Share.counts[0] = count


def shared_counts(file: Path) -> memoryview:
    """Return the 16-bit numbers in ``file``, which processes that have it see change."""
    with file.open("r+b") as stream:
        return memoryview(mmap.mmap(stream.fileno(), 0)).cast("H")


def use_shared_count(file: Path, place: int) -> None:
    """Let this process use as many processors as the number at ``place`` in ``file`` says at the time."""
    _Share.counts, _Share.place = shared_counts(file), place


class _LinearAlgebra:
    """The libraries of linear algebra, and how many modules there were when they were looked for."""

    modules = 0
    found: ThreadpoolController


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Let linear algebra work on one thread, then as before; torch is not asked, see `one_thread`.

    With several threads sums are rounded differently, and small matrices take many times as long on a busy machine.
    """
    if len(sys.modules) != _LinearAlgebra.modules:  # only imports bring libraries, and to look for them takes 6 ms
        _LinearAlgebra.found, _LinearAlgebra.modules = ThreadpoolController(), len(sys.modules)
    with _LinearAlgebra.found.limit(limits=1, user_api="blas"):
        yield


@contextmanager
def one_thread(seed: int) -> Iterator[None]:
    """Let torch work on one thread, with random numbers from ``seed``; then all is as it was before."""
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


def resolve(asked: Engine = "auto") -> Engine:
    """Return the engine that ``asked`` means: itself, but for "auto" the one in `SYSID_EVO_ENGINE`.

    "auto" is returned where that names no other: compiled where there are kernels, else NumPy. "reference" is NumPy in
    rollouts, imagined trials, parameter evolution and the fit of grey boxes. What has no NumPy form is compiled with
    either: simulations and sensitivities in the training of state spaces. Raises `InvalidArgument` for other values.
    """
    named = os.environ.get(ENGINE_VARIABLE) or "auto"
    if asked != "auto" or named == "auto":
        return asked
    if named != "reference":
        raise InvalidArgument(f"{ENGINE_VARIABLE}: expected auto or reference, got {named!r}. Set one, or unset it")
    return "reference"


def engine_inputs() -> dict[str, Engine]:
    """Return what digests contain of the engine: nothing with "auto", so that results stored before are found."""
    return {} if (engine := resolve()) == "auto" else {"engine": engine}
