"""Predictors around predictors: a turning frame, inputs kept in a range, a sum of two."""

from __future__ import annotations

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.engine.compiled.dialect import KernelSource
from sysid_evo.engine.compiled.lanes import LANES, view
from sysid_evo.engine.kernels.stepping import Predictor
from sysid_evo.motion import PlanarBody
from sysid_evo.system import System

FORWARD, LATERAL, YAW_RATE, PLANAR, CONTAINED, NX, RATE, OWN, HEADER = range(9)


def turning_frame(rate: Predictor, system: System, *, low: Array | None = None, high: Array | None = None) -> Predictor:
    """Return a predictor of dx/dt = rate + w(x), w how a planar body's turning frame changes its velocities.

    With ``low`` and ``high`` (nx,), what a state has beyond them decays with the time constant dt.
    """
    header = np.zeros(HEADER)
    header[[NX, RATE]] = system.nx, 1.0 / system.dt
    if isinstance(system.motion, PlanarBody):
        forward, lateral, yaw_rate = system.motion.indices(system.state_names)
        if lateral is not None:
            header[[FORWARD, LATERAL, YAW_RATE, PLANAR]] = forward, lateral, yaw_rate, 1.0
    limits = []
    if low is not None and high is not None:
        header[CONTAINED], limits = 1.0, [low, high]
    header[OWN] = HEADER + 2 * system.nx * (len(limits) > 0)
    return Predictor(
        KernelSource(turn, rate.bindings),
        np.concatenate([header, *limits, rate.parameters]),
        rate.n_scratch,
        prepare=KernelSource(prepare_turn, rate.bindings),
    )


def prepare_turn(u, p, scratch):
    """Prepare the rate."""
    prepare(u, view(p, int(p[OWN])), scratch)


def turn(x, u, p, y, scratch):
    """Write rate + w(x)."""
    predict(x, u, view(p, int(p[OWN])), y, scratch)
    if p[PLANAR] > 0.0:
        forward, lateral = int(p[FORWARD]) * LANES, int(p[LATERAL]) * LANES
        along, across, yaw_rate = view(x, forward), view(x, lateral), view(x, int(p[YAW_RATE]) * LANES)
        along_rate, across_rate = view(y, forward), view(y, lateral)
        for lane in range(LANES):
            along_rate[lane] += yaw_rate[lane] * across[lane]
            across_rate[lane] -= yaw_rate[lane] * along[lane]
    if p[CONTAINED] > 0.0:
        nx = int(p[NX])
        for row in range(nx):
            low, high, back = p[HEADER + row], p[HEADER + nx + row], p[RATE]
            here, rate = view(x, row * LANES), view(y, row * LANES)
            for lane in range(LANES):
                rate[lane] -= back * (here[lane] - min(max(here[lane], low), high))


N_CARRY, N_CONTROL, WITHIN = range(3)


def within(inner: Predictor, low: Array, high: Array, n_carry: int) -> Predictor:
    """Return a predictor that sees carry and control clipped to ``low`` and ``high`` (n_carry + nu,)."""
    header = np.array([n_carry, len(low) - n_carry], dtype=np.float64)
    return Predictor(
        KernelSource(clipped, inner.bindings),
        np.concatenate([header, low, high, inner.parameters]),
        len(low) + inner.n_scratch,
        prepare=KernelSource(prepare_clipped, inner.bindings),
    )


def prepare_clipped(u, p, scratch):
    """Clip the control, and prepare with it; it stands at the head of the scratch, then the carry."""
    n_carry, n_control = int(p[N_CARRY]), int(p[N_CONTROL])
    inputs = n_carry + n_control
    clip_rows(u, view(p, WITHIN + n_carry), view(p, WITHIN + inputs + n_carry), n_control, scratch)
    prepare(scratch, view(p, WITHIN + 2 * inputs), view(scratch, inputs * LANES))


def clipped(x, u, p, y, scratch):
    """Clip the carry, and predict from it and the clipped control."""
    n_carry, n_control = int(p[N_CARRY]), int(p[N_CONTROL])
    inputs = n_carry + n_control
    carry = view(scratch, n_control * LANES)
    clip_rows(x, view(p, WITHIN), view(p, WITHIN + inputs), n_carry, carry)
    predict(carry, scratch, view(p, WITHIN + 2 * inputs), y, view(scratch, inputs * LANES))


def clip_rows(x, low, high, count, y):
    """y = x clipped, row by row."""
    for row in range(count):
        here, there, least, most = view(x, row * LANES), view(y, row * LANES), low[row], high[row]
        for lane in range(LANES):
            there[lane] = min(max(here[lane], least), most)


FIRST_SIZE, FIRST_ROWS, SUM_NX, SUM = range(4)


def added(first: Predictor, second: Predictor, nx: int) -> Predictor:
    """Return a predictor of the sum of two; neither prepares anything."""
    header = np.array([len(first.parameters), first.n_scratch, nx], dtype=np.float64)
    return Predictor(
        KernelSource(add, {"one": first.function, "other": second.function}),
        np.concatenate([header, first.parameters, second.parameters]),
        nx + max(first.n_scratch, second.n_scratch),
    )


def add(x, u, p, y, scratch):
    """Write the sum."""
    room = view(scratch, int(p[SUM_NX]) * LANES)
    one(x, u, view(p, SUM), y, room)
    other(x, u, view(p, SUM + int(p[FIRST_SIZE])), scratch, room)
    for i in range(int(p[SUM_NX]) * LANES):
        y[i] += scratch[i]
