"""Compiles the program of a case for a device that is not there (compute capability 9.0)."""

from __future__ import annotations

import importlib.util
from types import SimpleNamespace
from typing import Any
from unittest import mock

from sysid_evo.engine.compiled.dialect import Precision
from sysid_evo.engine.compiled.generated import imported
from sysid_evo.engine.compiled.run import Kernels
from sysid_evo.randomness import trial_seeds

from .cases import Case

HOPPER = (9, 0)
MANY = 10**6


def assembly(case: Case, precision: Precision, *, trials: int = 10) -> str:
    """Return the PTX of the program that runs a case."""
    from numba import cuda, types

    from sysid_evo.engine.cuda import program
    from sysid_evo.engine.cuda.run import launch_of
    from sysid_evo.engine.cuda.trials import WHOLE, prepare

    task = case.task.bind(case.dynamics.system)
    controller = case.controller.bind_to(task)
    kernels = Kernels(case.dynamics.kernel(), controller.kernel(), task.kernel())  # type: ignore[arg-type]  # all there
    given = prepare(kernels, case.dynamics, controller, task, trial_seeds(0, trials), precision, record=False)
    launch = launch_of(kernels, given, MANY, precision)
    entry = imported(program.text(launch.threads, "", precision)).entry
    reals, wholes = (types.Array(kind, 1, "C") for kind in (getattr(types, precision), types.int64))
    kinds = [
        types.int64 if name in program.NUMBERS else wholes if name in WHOLE else reals for name in program.ARGUMENTS
    ]
    there: Any = SimpleNamespace(compute_capability=HOPPER)
    with mock.patch("numba.cuda.dispatcher.get_current_device", return_value=there):
        text, _ = cuda.compile(entry, types.void(*kinds), device=False, cc=HOPPER, abi="numba")
    return str(text)


def compiler_is_missing() -> str:
    """Return why nothing can be compiled here, empty if it can."""
    if importlib.util.find_spec("numba_cuda") is None:
        return "needs numba-cuda: pip install 'sysid-evo[cuda]'"
    from numba.cuda.cudadrv.nvvm import NVVM, LibDevice

    try:
        NVVM()
        LibDevice()
    except (ImportError, OSError, RuntimeError) as error:
        return f"needs the compiler of CUDA: pip install 'sysid-evo[cuda]' ({error})"
    return ""
