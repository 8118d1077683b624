"""Kernels of models with a correction of the acceleration or of the action, see `sysid_evo.models.adaptation`."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from sysid_evo.angles import TURN
from sysid_evo.errors import ShapeError
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
from sysid_evo.system import System
from sysid_evo.types import Array, check_shape

HEAD = Layout(
    "nx",
    "nu",
    "inputs",
    "count",
    "products",
    "gains",
    "dt",
    "limited",
    "inputs_at",
    "states_at",
    "coefficients_at",
    "frame",
    "own",
    align=CACHE_LINE,
)


def correction_kernel(
    inner: DynamicsKernel, system: System, terms: Mapping[str, Array], coefficients: Array
) -> DynamicsKernel | None:
    """Return the kernel of ``inner`` with ``coefficients`` (size, nx) of ``terms`` added to its accelerations.

    ``terms`` are the arrays of `sysid_evo.models.adaptation.correction.CorrectionTerms` by name. None if the motion has
    no compiled form.
    """
    motion = system.motion_kernel()
    if motion is None:
        return None
    if len(coefficients) != 1 + len(terms["centre"]) + len(terms["least"]) + len(terms["strength"]):
        raise ShapeError(f"coefficients: expected a row for each term, got {len(coefficients)}")
    check_shape("coefficients", coefficients, (None, system.nx))
    per_turn = np.array([TURN / system.periods[i] if i in system.periods else 0.0 for i in range(system.nx)])
    low, high, centre, least, most = (terms[name] for name in ("low", "high", "centre", "least", "most"))
    of_inputs = np.concatenate([low, high, centre, 1.0 / terms["scale"], least, most])
    gains, foreseen = len(terms["strength"]) > 0, [np.zeros(3 * system.nx)]
    if gains:
        foreseen = [terms["weakest"], terms["strongest"], 1.0 / terms["strength"]]
    of_states = np.concatenate([per_turn, terms["unit"], system.neutral_state, np.ravel(system.limits), *foreseen])
    parameters = HEAD.pack(
        nx=system.nx,
        nu=system.nu,
        inputs=len(centre),
        count=len(coefficients),
        products=len(least) > 0,
        gains=gains,
        dt=system.dt,
        limited=system.limited,
        inputs_at=of_inputs,
        states_at=of_states,
        coefficients_at=coefficients,
        frame=motion.parameters,
        own=inner.parameters,
    )
    bindings = {"inner": inner.source, "integrate": motion.integrate}
    room = 3 * system.nx + len(coefficients) + inner.n_scratch
    return DynamicsKernel(KernelSource(corrected, bindings), parameters, room, inner.precision)


def corrected(carry, control, noise, parameters, scratch):
    """Step the inner dynamics, compute the correction, and add it to the next state."""
    nx, nu = int(parameters[HEAD.nx]), int(parameters[HEAD.nu])
    rows, size, dt = nx * LANES, int(parameters[HEAD.count]), parameters[HEAD.dt]
    before, pushed, coasting, terms = scratch, view(scratch, rows), view(scratch, 2 * rows), view(scratch, 3 * rows)
    states = view(parameters, int(parameters[HEAD.states_at]))
    write_terms(
        carry,
        control,
        nx,
        nu,
        int(parameters[HEAD.inputs]),
        parameters[HEAD.products],
        states,
        view(parameters, int(parameters[HEAD.inputs_at])),
        terms,
    )
    for row in range(nx):
        store(before, row * LANES, load(carry, row * LANES))
        store(coasting, row * LANES, splat(0.0))
    frame = view(parameters, int(parameters[HEAD.frame]))
    integrate(before, coasting, nx, dt, frame)
    inner(carry, control, noise, view(parameters, int(parameters[HEAD.own])), view(scratch, 3 * rows + size * LANES))
    own = size
    if parameters[HEAD.gains] > 0.0:
        own = size - nx
        write_gains(carry, coasting, nx, dt, states, view(terms, own * LANES))
    numbers = view(parameters, int(parameters[HEAD.coefficients_at]))
    for row in range(nx):
        total, gained = splat(0.0), splat(0.0)
        for term in range(own):
            total = total + splat(numbers[term * nx + row]) * load(terms, term * LANES)
        for term in range(own, size):
            gained = gained + splat(numbers[term * nx + row]) * load(terms, term * LANES)
        store(pushed, row * LANES, total * splat(states[nx + row]))
        store(coasting, row * LANES, load(coasting, row * LANES) - gained * splat(dt * states[nx + row]))
    integrate(before, pushed, nx, dt, frame)
    moves = splat(0.0)
    for row in range(nx):
        moves = moves + abs(load(carry, row * LANES) - splat(states[2 * nx + row]))
    limited = parameters[HEAD.limited]
    for row in range(nx):
        here = load(carry, row * LANES)
        moved = here + (load(pushed, row * LANES) - load(coasting, row * LANES))
        moved = where_at_most(moves, 0.0, here, moved)
        if limited > 0.0:
            moved = min(max(moved, states[3 * nx + row]), states[4 * nx + row])
        store(carry, row * LANES, moved)


def write_gains(carry, coasting, nx, dt, states, terms):
    """Write the accelerations from coasting to the next state, for periodic states the shortest difference."""
    for row in range(nx):
        change = load(carry, row * LANES) - load(coasting, row * LANES)
        factor = states[row]
        if factor > 0.0:
            turn = TURN / factor
            change = where_at_most(change, 0.5 * turn, change, change - turn)
            change = where_at_most(change, -0.5 * turn, change + turn, change)
        seen = min(max(change / dt, states[5 * nx + row]), states[6 * nx + row])
        store(terms, row * LANES, seen * splat(states[7 * nx + row]))


def write_terms(carry, control, nx, nu, inputs, products, states, ranges, terms):
    """Write 1, the inputs clipped to the range of the recording, and their products."""
    store(terms, 0, splat(1.0))
    place = 0
    for row in range(nx):
        factor = states[row]
        if factor > 0.0:
            here, there = view(carry, row * LANES), view(terms, (1 + place) * LANES)
            for lane in range(LANES):
                there[lane] = math.sin(factor * here[lane])
                there[LANES + lane] = math.cos(factor * here[lane])
            place += 2
        else:
            store(terms, (1 + place) * LANES, load(carry, row * LANES))
            place += 1
    for row in range(nu):
        store(terms, (1 + place + row) * LANES, load(control, row * LANES))
    for i in range(inputs):
        seen = min(max(load(terms, (1 + i) * LANES), ranges[i]), ranges[inputs + i])
        store(terms, (1 + i) * LANES, (seen - ranges[2 * inputs + i]) * ranges[3 * inputs + i])
    if products > 0.0:
        place, count = 0, inputs * (inputs + 1) // 2
        least, most = view(ranges, 4 * inputs), view(ranges, 4 * inputs + count)
        for i in range(inputs):
            for k in range(i, inputs):
                both = load(terms, (1 + i) * LANES) * load(terms, (1 + k) * LANES)
                store(terms, (1 + inputs + place) * LANES, min(max(both, least[place]), most[place]))
                place += 1


ACTION = Layout("nu", "own", "delay", "before_at", align=CACHE_LINE)


def action_kernel(inner: DynamicsKernel, gain: Array, offset: Array, delay: float, n_carry: int) -> DynamicsKernel:
    """Return the kernel of ``inner`` under a corrected control, see `ActionCorrection`; ``n_carry`` is that of inner.

    With a delay, the control before is the end of the carry.
    """
    check_shape("offset", offset, gain.shape)
    parameters = ACTION.pack(gain, offset, nu=len(gain), own=inner.parameters, delay=delay, before_at=n_carry)
    source = KernelSource(under_corrected_action, {"inner": inner.source})
    return DynamicsKernel(source, parameters, len(gain) + inner.n_scratch, inner.precision)


def under_corrected_action(carry, control, noise, parameters, scratch):
    """Correct the control and step the inner dynamics."""
    nu, delay = int(parameters[ACTION.nu]), parameters[ACTION.delay]
    numbers, own = view(parameters, ACTION.size), view(parameters, int(parameters[ACTION.own]))
    before = view(carry, int(parameters[ACTION.before_at]) * LANES)
    for row in range(nu):
        acting = load(control, row * LANES)
        if delay > 0.0:
            acting = acting + splat(delay) * (load(before, row * LANES) - acting)
            store(before, row * LANES, load(control, row * LANES))
        store(scratch, row * LANES, splat(numbers[row]) * acting + splat(numbers[nu + row]))
    inner(carry, scratch, noise, own, view(scratch, nu * LANES))
