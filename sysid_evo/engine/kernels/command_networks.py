"""One small network for each command and each output, over lanes (paper, section 4.1).

Lanes are sorted by their command and evaluated sixteen at a time with the networks of that command.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from sysid_evo.arrays import Array, IntArray
from sysid_evo.engine.compiled.lanes import LANES, QUARTER, load_quarter, splat_quarter, store, view
from sysid_evo.engine.kernels.commands import command_cells
from sysid_evo.engine.kernels.stepping import Predictor

N_STATES, N_EXACT, N_OUT, HIDDEN, N_CONTROLS, CELLS, WEIGHTS, EXACT = range(8)


def command_network_predictor(
    first: Array,
    first_bias: Array,
    second: Array,
    second_bias: Array,
    serving: IntArray,
    midpoints: Sequence[Array],
    exact: Sequence[int],
    n_states: int,
) -> Predictor:
    """Return a predictor with a network for each command and output.

    For each of C commands and each output, a network with one tanh layer and a linear output:
    ``first`` (C, n_out, n_in, hidden), ``first_bias`` (C, n_out, hidden), ``second`` (C, n_out,
    hidden), ``second_bias`` (C, n_out). ``serving``, ``midpoints`` and ``exact`` as for
    `neighbour_predictor`; inputs are the state, then the exact controls.
    """
    commands, n_out, n_in, hidden = first.shape
    lookup = [float(i) for i in exact]
    for between in midpoints:
        lookup += [len(between), *between]
    cells = EXACT + len(lookup)
    weights = cells + len(serving)
    head = [n_states, len(exact), n_out, hidden, len(midpoints), cells, weights, *lookup, *serving]
    body = [
        np.concatenate([first_bias[c, k], first[c, k].ravel(), [second_bias[c, k]], second[c, k]])
        for c in range(commands)
        for k in range(n_out)
    ]
    rows = 2 + -(-((n_in + hidden + 1) * QUARTER + len(serving) + 2) // LANES)
    return Predictor(command_networks, np.concatenate([np.array(head, dtype=np.float64), *body]), n_scratch=rows)


def command_networks(x, u, p, y, scratch):
    """Write every output of the networks of each lane's command (a predictor, see `stepping`)."""
    n_states, n_exact, n_out = int(p[N_STATES]), int(p[N_EXACT]), int(p[N_OUT])
    hidden = int(p[HIDDEN])
    n_in = n_states + n_exact
    size = hidden * (n_in + 2) + 1
    cells, order = scratch, view(scratch, LANES)
    inputs = view(order, LANES)
    units = view(inputs, n_in * QUARTER)
    result = view(units, hidden * QUARTER)
    first = view(result, QUARTER)
    n_cells = int(p[WEIGHTS]) - int(p[CELLS])
    command_cells(u, view(p, EXACT + n_exact), int(p[N_CONTROLS]), cells)
    serving = view(p, int(p[CELLS]))
    sort_lanes(cells, order, first, n_cells)
    for cell in range(n_cells):
        begin, end = int(first[cell]), int(first[cell + 1])
        command = view(p, int(p[WEIGHTS]) + int(serving[cell]) * n_out * size)
        while begin < end:
            used = min(QUARTER, end - begin)
            lanes = view(order, begin)
            for i in range(QUARTER):
                lane = int(lanes[min(i, used - 1)])
                for row in range(n_states):
                    inputs[row * QUARTER + i] = x[row * LANES + lane]
                for row in range(n_exact):
                    inputs[(n_states + row) * QUARTER + i] = u[int(p[EXACT + row]) * LANES + lane]
            for k in range(n_out):
                one_network(inputs, n_in, view(command, k * size), hidden, units, result)
                for i in range(used):
                    y[k * LANES + int(lanes[i])] = result[i]
            begin += QUARTER


def sort_lanes(cells, order, first, n_cells):
    """Write the lanes in order of their cell, and where each of ``n_cells`` begins (one more is the end)."""
    for cell in range(n_cells + 2):
        first[cell] = 0.0
    for lane in range(LANES):
        first[int(cells[lane]) + 2] += 1.0
    for cell in range(n_cells):
        first[cell + 2] += first[cell + 1]
    place = view(first, 1)
    for lane in range(LANES):
        cell = int(cells[lane])
        order[int(place[cell])] = lane
        place[cell] += 1.0


def one_network(x, n_in, p, hidden, units, y):
    """Write the output of one network for a quarter of the lanes."""
    for j in range(hidden):
        total = splat_quarter(p[j])
        for row in range(n_in):
            total = total + splat_quarter(p[hidden + row * hidden + j]) * load_quarter(x, row * QUARTER)
        store(units, j * QUARTER, total)
    for i in range(hidden * QUARTER):
        units[i] = math.tanh(units[i])
    second = hidden * (n_in + 1)
    total = splat_quarter(p[second])
    for j in range(hidden):
        total = total + splat_quarter(p[second + 1 + j]) * load_quarter(units, j * QUARTER)
    store(y, 0, total)
