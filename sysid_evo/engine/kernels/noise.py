"""Any kernel with noise around it, see `sysid_evo.wrappers.Perturbed` and `NoisySensors`."""

from __future__ import annotations

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.engine.kernels.stepping import copy
from sysid_evo.kernels import CACHE_LINE, LANES, DynamicsKernel, KernelSource, Layout, padded, view
from sysid_evo.system import System

SENSORS = Layout("nx", "at", "shown_at", "n_noise", "own", align=CACHE_LINE)
PLANT = Layout("nx", "nu", "at", "latency", "stored", "process_at", "dropout_at", "own", align=CACHE_LINE)


def sensors_kernel(
    inner: DynamicsKernel, nx: int, n_inner: int, *, shown_at: int, n_noise: int, envelope: Array | None
) -> DynamicsKernel:
    """Return the kernel of ``inner`` (n_inner rows of carry), then what is observed, its bias and its noise."""
    if envelope is None:
        envelope = np.stack([np.full(nx, -np.inf), np.full(nx, np.inf)])
    limits = padded(np.ravel(envelope))
    parameters = SENSORS.pack(
        limits,
        inner.parameters,
        nx=nx,
        at=n_inner,
        shown_at=shown_at,
        n_noise=n_noise,
        own=SENSORS.size + len(limits),
    )
    return DynamicsKernel(KernelSource(sensed, {"inner": inner.source}), parameters, inner.n_scratch, inner.precision)


def sensed(carry, control, noise, parameters, scratch):
    """Step the inner dynamics, then write what is observed of it."""
    nx = int(parameters[SENSORS.nx])
    rows = nx * LANES
    inner(carry, control, noise, view(parameters, int(parameters[SENSORS.own])), scratch)
    shown, drawn = (
        view(carry, int(parameters[SENSORS.shown_at]) * LANES),
        view(noise, int(parameters[SENSORS.n_noise]) * LANES),
    )
    observed = view(carry, int(parameters[SENSORS.at]) * LANES)
    bias, level = view(observed, rows), view(observed, 2 * rows)
    for row in range(nx):
        here, there, off = view(shown, row * LANES), view(observed, row * LANES), view(bias, row * LANES)
        size, z = view(level, row * LANES), view(drawn, row * LANES)
        low, high = parameters[SENSORS.size + row], parameters[SENSORS.size + nx + row]
        for lane in range(LANES):
            there[lane] = min(max(here[lane], low), high) + off[lane] + size[lane] * z[lane]


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
    """Return the kernel of ``inner`` (n_inner rows of carry) with late, lost and stronger commands and answers."""
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
