"""The kernel of a disturbed model: the compiled form of `sysid_evo.models.disturbances.Disturbed`."""

from __future__ import annotations

import numpy as np

from sysid_evo.kernels import (
    CACHE_LINE,
    LANES,
    DynamicsKernel,
    KernelSource,
    Layout,
    load,
    splat,
    store,
    view,
    where_at_most,
)
from sysid_evo.models.kernels.stepping import copy
from sysid_evo.system import System
from sysid_evo.types import Array

HEAD = Layout(
    "nx", "nu", "latency", "kept", "whole", "share", "moved_at", "process_at", "observed_at", "sensed_at", "sensor_at",
    "own", align=CACHE_LINE,
)  # fmt: skip


def disturbed_kernel(
    inner: DynamicsKernel, system: System, *, free_controls: Array, state_bounds: Array | None, **head: float
) -> DynamicsKernel:
    """Return the kernel of ``inner`` with rows added to its carry; ``head`` are the numbers of `HEAD`.

    Commands are delayed by at most ``latency`` samples where ``free_controls`` (nu,) is above 0. The observed state is
    delayed by ``whole`` samples and a ``share`` of one, for which ``kept`` states are stored, and clipped to
    ``state_bounds`` (2, nx). The other numbers are rows, -1 if absent: in the carry, the first ones of gains,
    observations and sensor errors (``moved_at``, ``observed_at``, ``sensed_at``); in the noise, ``process_at`` and
    ``sensor_at``.
    """
    limits = np.repeat([-np.inf, np.inf], system.nx) if state_bounds is None else np.ravel(state_bounds)
    parameters = HEAD.pack(limits, free_controls, nx=system.nx, nu=system.nu, own=inner.parameters, **head)
    room = system.nx + system.nu + inner.n_scratch
    return DynamicsKernel(KernelSource(disturbed, {"inner": inner.source}), parameters, room, inner.precision)


def disturbed(carry, control, noise, parameters, scratch):
    """Choose the command that acts, step the inner dynamics with it, disturb the state, and write the observation."""
    nx, nu = int(parameters[HEAD.nx]), int(parameters[HEAD.nu])
    moved, seen, limits = parameters[HEAD.moved_at], parameters[HEAD.observed_at], view(parameters, HEAD.size)
    rows, size, before, acts = nx * LANES, nu * LANES, scratch, control
    if moved >= 0.0:
        copy(carry, before, rows)
        acts = view(scratch, rows)
        late(
            control,
            acts,
            view(carry, (int(moved) + 2 * nx) * LANES),
            int(parameters[HEAD.latency]),
            nu,
            view(limits, 2 * nx),
        )
    if seen >= 0.0:
        remember(carry, view(carry, (int(seen) + nx) * LANES), int(parameters[HEAD.kept]), rows)
    inner(carry, acts, noise, view(parameters, int(parameters[HEAD.own])), view(scratch, rows + size))
    if moved >= 0.0:
        gain = view(carry, int(moved) * LANES)
        for row in range(nx):
            start = load(before, row * LANES)
            change = load(carry, row * LANES) - start
            store(carry, row * LANES, start + load(gain, row * LANES) * change)
    if parameters[HEAD.process_at] >= 0.0:
        process = view(carry, (int(moved) + nx) * LANES)
        shaken = view(noise, int(parameters[HEAD.process_at]) * LANES)
        for row in range(nx):
            pushed = load(process, row * LANES) * load(shaken, row * LANES)
            store(carry, row * LANES, load(carry, row * LANES) + pushed)
    if seen >= 0.0:
        observed, whole, share = view(carry, int(seen) * LANES), int(parameters[HEAD.whole]), parameters[HEAD.share]
        states = view(observed, rows)
        for row in range(nx):
            later = min(max(load(carry, row * LANES), limits[row]), limits[nx + row])
            if whole > 0:
                later = load(states, ((whole - 1) * nx + row) * LANES)
            if share > 0.0:
                later = later - splat(share) * (later - load(states, (whole * nx + row) * LANES))
            store(observed, row * LANES, later)
    if parameters[HEAD.sensor_at] >= 0.0:
        observed, bias = view(carry, int(seen) * LANES), view(carry, int(parameters[HEAD.sensed_at]) * LANES)
        level, drawn = view(bias, rows), view(noise, int(parameters[HEAD.sensor_at]) * LANES)
        for row in range(nx):
            there = load(observed, row * LANES) + load(bias, row * LANES)
            store(observed, row * LANES, there + load(level, row * LANES) * load(drawn, row * LANES))


def late(control, acts, delay, latency, nu, free):
    """Write the command that acts, at most ``latency`` samples old, and store the new one."""
    size, commands = nu * LANES, view(delay, LANES)
    copy(control, acts, size)
    for back in range(1, latency + 1):
        off = abs(load(delay, 0) - float(back))
        for row in range(nu):
            if free[row] > 0.0:
                older = load(commands, ((back - 1) * nu + row) * LANES)
                store(acts, row * LANES, where_at_most(off, 0.0, older, load(acts, row * LANES)))
    remember(control, commands, latency, size)


def remember(newest, past, count, size):
    """Insert ``newest`` before ``count`` blocks of ``size`` numbers, and drop the last one."""
    for back in range(count - 1, 0, -1):
        copy(view(past, (back - 1) * size), view(past, back * size), size)
    if count > 0:
        copy(newest, past, size)
