"""From a prediction to the next carry: integration by the motion, noise, limits, lags; Runge-Kutta."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from sysid_evo.kernels import (
    CACHE_LINE,
    LANES,
    DynamicsKernel,
    KernelSource,
    Layout,
    MotionKernel,
    Predictor,
    load,
    splat,
    store,
    view,
    where_less,
)
from sysid_evo.motion_kernels import move_nothing, turn_nothing
from sysid_evo.system import System
from sysid_evo.types import Array

Output: TypeAlias = Literal["next_state", "acceleration"]

STEP = Layout(
    "nx",
    "nu",
    "state_lags",
    "control_lags",
    "dt",
    "limited",
    "frame",
    "noise",
    "limits",
    "own",
    align=CACHE_LINE,
)


@dataclass(frozen=True)
class StepNoise:
    """Normal noise added to the prediction in every step: ``white``, and ``lasting``, which is constant during a run.

    Both (len(edges) + 1, nx) are in units of the states; a row is used until the steps since the start reach its edge.
    After the lags the carry holds the lasting draws (nx), the number of steps, and a factor f of the noise. This is
    f (1 + g (1 - 1 / f)^2) times as large, with ``growth`` g (len(edges) + 1, nx).
    """

    edges: Sequence[int]
    white: Array
    lasting: Array
    growth: Array

    @property
    def parameters(self) -> Array:
        """The parameters of `add_noise`: number of edges, edges, and alternately white and lasting sizes and growth."""
        rows = np.concatenate([self.white, self.lasting, self.growth], axis=1)
        return np.concatenate([[len(self.edges)], self.edges, np.ravel(rows)])


def stepping_kernel(
    predictor: Predictor,
    system: System,
    *,
    output: Output,
    lags: tuple[int, int] = (0, 0),
    noise: StepNoise | None = None,
) -> DynamicsKernel | None:
    """Return the kernel of a model whose predictor returns the next state or an acceleration.

    None if an acceleration must be integrated and the system's motion has no compiled form.
    The carry is that of `DynamicsModel`: state, earlier states, earlier controls (``lags``).
    ``noise`` is added to the prediction. States are clipped to the limits of their channels.
    """
    motion = REACHED if output == "next_state" else system.motion_kernel()
    if motion is None:
        return None
    nx, nu = system.nx, system.nu
    predictor.check(nx * (1 + lags[0]) + nu * lags[1], nu, nx)
    limits = np.ravel(system.limits) if system.limited else np.empty(0)
    parameters = STEP.pack(
        nx=nx,
        nu=nu,
        state_lags=lags[0],
        control_lags=lags[1],
        dt=system.dt,
        limited=system.limited,
        frame=motion.parameters,
        noise=np.empty(0) if noise is None else noise.parameters,
        limits=limits,
        own=predictor.parameters,
    )
    disturb = no_noise if noise is None else add_noise
    bindings = {**predictor.bindings, "integrate": motion.integrate, "disturb": disturb}
    return DynamicsKernel(KernelSource(step, bindings), parameters, nx + predictor.n_scratch)


def step(carry, control, noise, parameters, scratch):
    """Predict, integrate, add noise, keep within limits, and shift the lags."""
    nx, nu = int(parameters[STEP.nx]), int(parameters[STEP.nu])
    rows = nx * LANES
    own, room = view(parameters, int(parameters[STEP.own])), view(scratch, rows)
    prepare(control, own, room)
    predict(carry, control, own, scratch, room)
    integrate(carry, scratch, nx, parameters[STEP.dt], view(parameters, int(parameters[STEP.frame])))
    state_lags, control_lags = int(parameters[STEP.state_lags]), int(parameters[STEP.control_lags])
    size, past = nu * LANES, view(carry, (1 + state_lags) * rows)
    disturb(view(past, control_lags * size), noise, scratch, nx, view(parameters, int(parameters[STEP.noise])))
    if parameters[STEP.limited] > 0.0:
        limits = view(parameters, int(parameters[STEP.limits]))
        for row in range(nx):
            there = load(scratch, row * LANES)
            store(scratch, row * LANES, min(max(there, limits[row]), limits[nx + row]))
    for back in range(state_lags, 0, -1):
        copy(view(carry, (back - 1) * rows), view(carry, back * rows), rows)
    for back in range(control_lags - 1, 0, -1):
        copy(view(past, (back - 1) * size), view(past, back * size), size)
    if control_lags > 0:
        copy(control, past, size)
    copy(scratch, carry, rows)


def reached(state, after, nx, dt, p):
    """Do not change the predicted state."""
    return


REACHED = MotionKernel(reached, turn_nothing, move_nothing)
"""For a model that predicts the next state itself: nothing is integrated."""


def no_noise(held, noise, after, nx, p):
    """Do not change the predicted state."""
    return


def add_noise(held, noise, after, nx, p):
    """Add the noise of this step to ``after``, whose size depends on the number of steps, and count the step."""
    edges = int(p[0])
    sizes, count, factor = view(p, 1 + edges), load(held, nx * LANES), load(held, (nx + 1) * LANES)
    share = 1.0 - 1.0 / max(factor, 1.0)
    for row in range(nx):
        at = 3 * nx * edges + row
        white, lasting, growth = splat(sizes[at]), splat(sizes[at + nx]), splat(sizes[at + 2 * nx])
        for back in range(edges):
            edge = edges - 1 - back
            at = 3 * nx * edge + row
            white = where_less(count, p[1 + edge], sizes[at], white)
            lasting = where_less(count, p[1 + edge], sizes[at + nx], lasting)
            growth = where_less(count, p[1 + edge], sizes[at + 2 * nx], growth)
        moved = white * load(noise, row * LANES) + lasting * load(held, row * LANES)
        store(after, row * LANES, load(after, row * LANES) + factor * (1.0 + growth * share * share) * moved)
    store(held, nx * LANES, count + 1.0)


def copy(source, target, count):
    """Copy ``count`` numbers, whole rows."""
    for first in range(0, count, LANES):
        store(target, first, load(source, first))


RUNGE_KUTTA = Layout("nx", "n_carry", "substeps", "h", align=CACHE_LINE)


def runge_kutta_predictor(
    derivative: Predictor, system: System, *, substeps: int = 1, n_carry: int | None = None
) -> Predictor:
    """Return a predictor of the next state from one of dx/dt.

    It is the classical fourth-order step with the control held; one ``system.dt`` is divided into ``substeps``. Lags in
    a carry of ``n_carry`` rows (default: the state alone) are constant during the step.
    """
    rows = n_carry or system.nx
    derivative.check(rows, system.nu, system.nx)
    return Predictor(
        KernelSource(runge_kutta, {**derivative.bindings, "NX": system.nx, "N_CARRY": rows}),
        RUNGE_KUTTA.pack(derivative.parameters, nx=system.nx, n_carry=rows, substeps=substeps, h=system.dt / substeps),
        n_scratch=rows + 2 * system.nx + derivative.n_scratch,
        reads=(rows, system.nu),
        writes=system.nx,
    )


def runge_kutta(x, u, p, y, scratch):
    """Write the state after one dt: k1 to k4 at both ends and twice in the middle of every substep."""
    h, own_parameters = p[RUNGE_KUTTA.h], view(p, RUNGE_KUTTA.size)
    trial = scratch
    slope = view(scratch, N_CARRY * LANES)
    total = view(slope, NX * LANES)
    room = view(total, NX * LANES)
    prepare(u, own_parameters, room)
    copy_rows(x, trial, N_CARRY)
    copy_rows(x, y, NX)
    for _ in range(int(p[RUNGE_KUTTA.substeps])):
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
    """target = start + time * slope, one row at a time, so that no test for overlapping arrays is needed."""
    for row in range(count):
        moved = load(start, row * LANES) + splat(time) * load(slope, row * LANES)
        store(target, row * LANES, moved)


def copy_rows(source, target, count):
    """Copy ``count`` rows."""
    for row in range(count):
        store(target, row * LANES, load(source, row * LANES))
