"""A kernel with noise, delay or lost commands around it: the compiled forms of `sysid_evo.models.disturbances`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sysid_evo.kernels import (
    CACHE_LINE,
    LANES,
    DynamicsKernel,
    KernelSource,
    Layout,
    load,
    padded,
    splat,
    store,
    view,
    where_less,
)
from sysid_evo.models.kernels.stepping import copy
from sysid_evo.system import System
from sysid_evo.types import Array

SENSORS = Layout("nx", "at", "shown_at", "n_noise", "own", align=CACHE_LINE)


def sensors_kernel(
    inner: DynamicsKernel, nx: int, n_inner: int, *, shown_at: int, n_noise: int, envelope: Array | None
) -> DynamicsKernel:
    """Return the kernel of `NoisySensors`: ``inner`` (n_inner rows of carry), what is observed, its bias and noise."""
    limits = _limits(envelope, nx)
    parameters = SENSORS.pack(
        limits, inner.parameters, nx=nx, at=n_inner, shown_at=shown_at, n_noise=n_noise, own=SENSORS.size + len(limits)
    )
    return DynamicsKernel(KernelSource(sensed, {"inner": inner.source}), parameters, inner.n_scratch, inner.precision)


def sensed(carry, control, noise, parameters, scratch):
    """Step the inner dynamics, then write what is observed of it."""
    nx = int(parameters[SENSORS.nx])
    rows = nx * LANES
    inner(carry, control, noise, view(parameters, int(parameters[SENSORS.own])), scratch)
    shown = view(carry, int(parameters[SENSORS.shown_at]) * LANES)
    drawn = view(noise, int(parameters[SENSORS.n_noise]) * LANES)
    observed = view(carry, int(parameters[SENSORS.at]) * LANES)
    bias, level = view(observed, rows), view(observed, 2 * rows)
    for row in range(nx):
        here, there, off = view(shown, row * LANES), view(observed, row * LANES), view(bias, row * LANES)
        size, z = view(level, row * LANES), view(drawn, row * LANES)
        low, high = parameters[SENSORS.size + row], parameters[SENSORS.size + nx + row]
        for lane in range(LANES):
            there[lane] = min(max(here[lane], low), high) + off[lane] + size[lane] * z[lane]


def _limits(envelope: Array | None, nx: int) -> Array:
    """Return lowest and highest states, infinite without an ``envelope``."""
    return padded(np.ravel(np.repeat([-np.inf, np.inf], nx) if envelope is None else envelope))


PLANT = Layout("nx", "nu", "at", "latency", "stored", "process_at", "dropout_at", "own", align=CACHE_LINE)


def perturbed_kernel(
    inner: DynamicsKernel,
    system: System,
    n_inner: int,
    *,
    free_controls: Array,
    latency: int,
    stored: int,
    process_at: int,
    dropout_at: int,
) -> DynamicsKernel:
    """Return the kernel of `Perturbed`: ``inner`` (n_inner rows of carry) with late, lost and stronger commands."""
    numbers = padded(np.concatenate([system.neutral_state, system.neutral_control, free_controls]))
    parameters = PLANT.pack(
        numbers,
        inner.parameters,
        nx=system.nx,
        nu=system.nu,
        at=n_inner,
        latency=latency,
        stored=stored,
        process_at=process_at,
        dropout_at=dropout_at,
        own=PLANT.size + len(numbers),
    )
    room = 2 * system.nu + system.nx + inner.n_scratch
    return DynamicsKernel(KernelSource(perturbed, {"inner": inner.source}), parameters, room, inner.precision)


def perturbed(carry, control, noise, parameters, scratch):
    """Receive the command or not, choose the one that acts now, step the model in its own state, and scale that."""
    nx, nu, stored = int(parameters[PLANT.nx]), int(parameters[PLANT.nu]), int(parameters[PLANT.stored])
    rows, size = nx * LANES, nu * LANES
    gain = view(carry, int(parameters[PLANT.at]) * LANES)
    scale, process, effect = view(gain, rows), view(gain, 2 * rows), view(gain, 3 * rows)
    delay, threshold, past = view(effect, size), view(effect, size + LANES), view(effect, size + 2 * LANES)
    received, applied, before = scratch, view(scratch, size), view(scratch, 2 * size)
    rest, numbers = view(parameters, PLANT.size), view(parameters, PLANT.size + nx)
    copy(control, received, size)
    if parameters[PLANT.dropout_at] >= 0.0:
        lost = view(noise, int(parameters[PLANT.dropout_at]) * LANES)
        for row in range(nu):
            if numbers[nu + row] > 0.0:
                got, last = view(received, row * LANES), view(past, row * LANES)
                for lane in range(LANES):
                    got[lane] = last[lane] if lost[lane] < threshold[lane] else got[lane]
    copy(received, applied, size)
    for back in range(1, int(parameters[PLANT.latency]) + 1):
        for row in range(nu):
            if numbers[nu + row] > 0.0:
                acts, older = view(applied, row * LANES), view(past, ((back - 1) * nu + row) * LANES)
                number = float(back)
                for lane in range(LANES):
                    acts[lane] = older[lane] if delay[lane] == number else acts[lane]
    for back in range(stored - 1, 0, -1):
        copy(view(past, (back - 1) * size), view(past, back * size), size)
    if stored > 0:
        copy(received, past, size)
    for row in range(nu):
        acts, factor, idle = view(applied, row * LANES), view(effect, row * LANES), numbers[row]
        for lane in range(LANES):
            acts[lane] = idle + factor[lane] * (acts[lane] - idle)
    for row in range(nx):
        here, factor, start, still = (
            view(carry, row * LANES),
            view(scale, row * LANES),
            view(before, row * LANES),
            rest[row],
        )
        for lane in range(LANES):
            start[lane] = still + (here[lane] - still) / factor[lane]
    copy(before, carry, rows)
    inner(carry, applied, noise, view(parameters, int(parameters[PLANT.own])), view(before, rows))
    for row in range(nx):
        here, start, still = view(carry, row * LANES), view(before, row * LANES), rest[row]
        speed, factor = view(gain, row * LANES), view(scale, row * LANES)
        for lane in range(LANES):
            here[lane] = still + factor[lane] * (start[lane] + speed[lane] * (here[lane] - start[lane]) - still)
    if parameters[PLANT.process_at] >= 0.0:
        for row in range(nx):
            here, level = view(carry, row * LANES), view(process, row * LANES)
            z = view(noise, (int(parameters[PLANT.process_at]) + row) * LANES)
            for lane in range(LANES):
                here[lane] += level[lane] * z[lane]


DELAY = Layout("nx", "at", "whole", "share", "own", align=CACHE_LINE)


def delayed_kernel(
    inner: DynamicsKernel, nx: int, n_inner: int, *, whole: int, share: float, envelope: Array | None
) -> DynamicsKernel:
    """Return the kernel of `DelayedEstimate`: ``inner``, then what is observed, then the last ``whole`` states."""
    limits = _limits(envelope, nx)
    parameters = DELAY.pack(
        limits, inner.parameters, nx=nx, at=n_inner, whole=whole, share=share, own=DELAY.size + len(limits)
    )
    return DynamicsKernel(
        KernelSource(delayed, {"inner": inner.source}), parameters, 2 * nx + inner.n_scratch, inner.precision
    )


def delayed(carry, control, noise, parameters, scratch):
    """Step the inner dynamics, then write what is observed and move the past states one place back."""
    nx, whole, share = int(parameters[DELAY.nx]), int(parameters[DELAY.whole]), parameters[DELAY.share]
    rows = nx * LANES
    before, after = view(scratch, 0), view(scratch, rows)
    copy(carry, before, rows)
    inner(carry, control, noise, view(parameters, int(parameters[DELAY.own])), view(scratch, 2 * rows))
    observed = view(carry, int(parameters[DELAY.at]) * LANES)
    past = view(observed, rows)
    for row in range(nx):
        here, there = view(carry, row * LANES), view(after, row * LANES)
        low, high = parameters[DELAY.size + row], parameters[DELAY.size + nx + row]
        for lane in range(LANES):
            there[lane] = min(max(here[lane], low), high)
    if whole == 0:
        between(after, before, share, observed, rows)
        return
    if whole == 1:
        between(before, past, share, observed, rows)
    else:
        between(view(past, (whole - 2) * rows), view(past, (whole - 1) * rows), share, observed, rows)
    for back in range(whole - 1, 0, -1):
        copy(view(past, (back - 1) * rows), view(past, back * rows), rows)
    copy(before, past, rows)


def between(later, earlier, share, observed, count):
    """Write (1 - share) later + share earlier."""
    for i in range(count):
        observed[i] = later[i] - share * (later[i] - earlier[i])


NOISE = Layout("nx", "at", "edges", "sizes", "limits", "own", align=CACHE_LINE)


def disturbed_kernel(
    inner: DynamicsKernel, system: System, n_inner: int, *, edges: Sequence[int], white: Array, lasting: Array
) -> DynamicsKernel:
    """Return the kernel of `Uncertain`: ``inner``, then the lasting draws (nx) and the count of steps.

    The noise of every step is new and lasting, and its size depends on the steps since the start.
    ``white`` and ``lasting`` (len(edges) + 1, nx) are the sizes of the noise, in units of the states; one row holds
    until the count reaches its edge. The state stays within the limits of its channels.
    """
    nx = system.nx
    low, high = system.limits if system.limited else (np.full(nx, -np.inf), np.full(nx, np.inf))
    sizes = np.concatenate([white, lasting], axis=1)
    numbers = padded(np.concatenate([np.array(edges, dtype=np.float64), np.ravel(sizes), low, high]))
    first = NOISE.size + len(edges)
    parameters = NOISE.pack(
        numbers,
        inner.parameters,
        nx=nx,
        at=n_inner,
        edges=len(edges),
        sizes=first,
        limits=first + sizes.size,
        own=NOISE.size + len(numbers),
    )
    return DynamicsKernel(KernelSource(disturb, {"inner": inner.source}), parameters, inner.n_scratch, inner.precision)


def disturb(carry, control, noise, parameters, scratch):
    """Step, move the state by the noise of this step, and count it."""
    nx, edges = int(parameters[NOISE.nx]), int(parameters[NOISE.edges])
    inner(carry, control, noise, view(parameters, int(parameters[NOISE.own])), scratch)
    held = view(carry, int(parameters[NOISE.at]) * LANES)
    sizes, limits = (view(parameters, int(parameters[NOISE.sizes])), view(parameters, int(parameters[NOISE.limits])))
    count = load(held, nx * LANES)
    for row in range(nx):
        white, lasting = splat(sizes[2 * nx * edges + row]), splat(sizes[2 * nx * edges + nx + row])
        for back in range(edges):
            edge = edges - 1 - back
            white = where_less(count, parameters[NOISE.size + edge], sizes[2 * nx * edge + row], white)
            lasting = where_less(count, parameters[NOISE.size + edge], sizes[2 * nx * edge + nx + row], lasting)
        moved = white * load(noise, row * LANES) + lasting * load(held, row * LANES)
        there = load(carry, row * LANES) + moved
        store(carry, row * LANES, min(max(there, limits[row]), limits[nx + row]))
    store(held, nx * LANES, count + 1.0)
