"""The classical fourth-order Runge-Kutta step around any derivative, control held (zero-order hold)."""

from __future__ import annotations

import numpy as np

from sysid_evo.engine.compiled.dialect import KernelSource
from sysid_evo.engine.compiled.lanes import LANES, view
from sysid_evo.engine.kernels.stepping import Predictor, copy
from sysid_evo.system import System

NX, N_CARRY, SUBSTEPS, H, HEADER = range(5)


def runge_kutta_predictor(
    derivative: Predictor, system: System, *, substeps: int = 1, n_carry: int | None = None
) -> Predictor:
    """Return a predictor of the next state from one of dx/dt.

    One ``system.dt`` is cut into ``substeps``. Lags in a carry of ``n_carry`` rows (default: the
    state alone) are held during the step.
    """
    rows = n_carry or system.nx
    header = np.array([system.nx, rows, substeps, system.dt / substeps])
    return Predictor(
        KernelSource(runge_kutta, derivative.bindings),
        np.concatenate([header, np.ravel(derivative.parameters)]),
        n_scratch=rows + 2 * system.nx + derivative.n_scratch,
    )


def runge_kutta(x, u, p, y, scratch):
    """Write the state after one dt: k1 to k4 at both ends and twice in the middle of every substep."""
    size, h, own_parameters = int(p[NX]) * LANES, p[H], view(p, HEADER)
    trial, n_carry = scratch, int(p[N_CARRY])
    slope = view(scratch, n_carry * LANES)
    total = view(slope, size)
    room = view(total, size)
    prepare(u, own_parameters, room)
    copy(x, trial, n_carry * LANES)
    copy(x, y, size)
    for _ in range(int(p[SUBSTEPS])):
        for stage in range(4):
            predict(trial, u, own_parameters, slope, room)
            if stage == 0:
                copy(slope, total, size)
                move(y, slope, 0.5 * h, trial, size)
            elif stage == 1:
                move(total, slope, 2.0, total, size)
                move(y, slope, 0.5 * h, trial, size)
            elif stage == 2:
                move(total, slope, 2.0, total, size)
                move(y, slope, h, trial, size)
            else:
                move(total, slope, 1.0, total, size)
                move(y, total, h / 6.0, y, size)
                copy(y, trial, size)


def move(start, slope, time, target, count):
    """target = start + time * slope."""
    for i in range(count):
        target[i] = start[i] + time * slope[i]
