"""The classical fourth-order Runge-Kutta step around any derivative, control held (zero-order hold)."""

from __future__ import annotations

from sysid_evo.kernels import CACHE_LINE, LANES, KernelSource, Layout, Predictor, load, splat, store, view
from sysid_evo.system import System

HEAD = Layout("nx", "n_carry", "substeps", "h", align=CACHE_LINE)


def runge_kutta_predictor(
    derivative: Predictor, system: System, *, substeps: int = 1, n_carry: int | None = None
) -> Predictor:
    """Return a predictor of the next state from one of dx/dt.

    One ``system.dt`` is cut into ``substeps``. Lags in a carry of ``n_carry`` rows (default: the
    state alone) are held during the step.
    """
    rows = n_carry or system.nx
    return Predictor(
        KernelSource(runge_kutta, {**derivative.bindings, "NX": system.nx, "N_CARRY": rows}),
        HEAD.pack(derivative.parameters, nx=system.nx, n_carry=rows, substeps=substeps, h=system.dt / substeps),
        n_scratch=rows + 2 * system.nx + derivative.n_scratch,
    )


def runge_kutta(x, u, p, y, scratch):
    """Write the state after one dt: k1 to k4 at both ends and twice in the middle of every substep."""
    h, own_parameters = p[HEAD.h], view(p, HEAD.size)
    trial = scratch
    slope = view(scratch, N_CARRY * LANES)
    total = view(slope, NX * LANES)
    room = view(total, NX * LANES)
    prepare(u, own_parameters, room)
    copy_rows(x, trial, N_CARRY)
    copy_rows(x, y, NX)
    for _ in range(int(p[HEAD.substeps])):
        for stage in range(4):
            predict(trial, u, own_parameters, slope, room)
            if stage == 0:
                copy_rows(slope, total, NX)
                move_rows(y, slope, 0.5 * h, trial, NX)
            elif stage < 3:
                move_rows(total, slope, 2.0, total, NX)
                move_rows(y, slope, 0.5 * h if stage == 1 else h, trial, NX)
            else:
                move_rows(total, slope, 1.0, total, NX)
                move_rows(y, total, h / 6.0, y, NX)
                copy_rows(y, trial, NX)


def move_rows(start, slope, time, target, count):
    """target = start + time * slope, a row at a time: short loops need no test whether arrays overlap."""
    for row in range(count):
        moved = load(start, row * LANES) + splat(time) * load(slope, row * LANES)
        store(target, row * LANES, moved)


def copy_rows(source, target, count):
    """Copy ``count`` rows."""
    for row in range(count):
        store(target, row * LANES, load(source, row * LANES))
