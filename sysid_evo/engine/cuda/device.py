"""Whether rollouts can run on a device here, and when it pays."""

from __future__ import annotations

import ctypes
import importlib.util
import os
from functools import cache

from sysid_evo.errors import MissingExtra, NoDevice

ENOUGH = 2**14
"""Rollouts at once from which ``engine="auto"`` takes the device.

About as many as put one warp on every scheduler of a large device (132 x 4 x 32); with fewer, most of it waits for
single rollouts, and processors are as fast. ``python -m tests.benchmarks.cuda`` measures where the two cross.
"""


def check() -> None:
    """Raise `MissingExtra` or `NoDevice`, with what to do, if no rollout can run on a device here."""
    if importlib.util.find_spec("numba_cuda") is None:
        raise MissingExtra("engine 'cuda' needs the package numba-cuda: pip install 'sysid-evo[cuda]'")
    if not _simulated() and not _driver():
        raise NoDevice(
            "engine 'cuda' needs an NVIDIA device; its driver was not found: use engine 'auto', which needs none"
        )
    from numba import cuda

    if not cuda.is_available():
        raise NoDevice(
            "engine 'cuda': there is a driver, but no device or no compiler of CUDA: look at `nvidia-smi`, "
            "and install the compiler with pip install 'sysid-evo[cuda]'"
        )


@cache
def at_hand() -> bool:
    """Return whether a real device can be used; looks once a process, and imports nothing where there is no driver."""
    if _simulated() or not _driver():
        return False
    try:
        check()
    except (MissingExtra, NoDevice):
        return False
    return True


def pays(rollouts: int) -> bool:
    """Return whether so many rollouts are better run on the device that is at hand."""
    return rollouts >= ENOUGH and at_hand()


def _simulated() -> bool:
    return os.environ.get("NUMBA_ENABLE_CUDASIM", "0") not in ("", "0")


def _driver() -> bool:
    try:
        ctypes.CDLL("libcuda.so.1")
    except OSError:
        return False
    return True
