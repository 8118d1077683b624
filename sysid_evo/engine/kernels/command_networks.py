"""One small network for each command and each output, over lanes (paper, section 4.1).

Lanes are sorted by their command, so that sixteen at a time are evaluated with the networks of that
command, all hidden units as one layer. A command's last sixteen run over into the lanes of the next
command, which writes them again: rows are that much longer than the lanes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sysid_evo.arrays import Array, IntArray
from sysid_evo.engine.compiled.lanes import (
    LANES,
    QUARTER,
    first_lane,
    lanes_less,
    load_quarter,
    splat_quarter,
    store,
    view,
)
from sysid_evo.engine.compiled.layout import Layout
from sysid_evo.engine.kernels.commands import command_cells
from sysid_evo.engine.kernels.networks import squash
from sysid_evo.engine.kernels.stepping import Predictor

HEAD = Layout("n_states", "n_exact", "n_out", "hidden", "n_controls", "cells", "weights")
WIDE = LANES + QUARTER


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
    cells = HEAD.size + len(lookup)
    body = [
        np.concatenate([first_bias[c].ravel(), first[c].transpose(1, 0, 2).ravel(), second_bias[c], second[c].ravel()])
        for c in range(commands)
    ]
    rows = 2 + -(-((n_in + n_out * hidden + n_out) * WIDE + len(serving)) // LANES)
    parameters = HEAD.pack(
        lookup,
        serving,
        *body,
        n_states=n_states,
        n_exact=len(exact),
        n_out=n_out,
        hidden=hidden,
        n_controls=len(midpoints),
        cells=cells,
        weights=cells + len(serving),
    )
    return Predictor(command_networks, parameters, n_scratch=rows)


def command_networks(x, u, p, y, scratch):
    """Write every output of the networks of each lane's command (a predictor, see `stepping`)."""
    n_states, n_exact, n_out = int(p[HEAD.n_states]), int(p[HEAD.n_exact]), int(p[HEAD.n_out])
    hidden, n_in = int(p[HEAD.hidden]), n_states + n_exact
    n_units, n_cells = n_out * hidden, int(p[HEAD.weights]) - int(p[HEAD.cells])
    size = n_units * (n_in + 2) + n_out
    cells, order, inputs = scratch, view(scratch, LANES), view(scratch, 2 * LANES)
    units = view(inputs, n_in * WIDE)
    result = view(units, n_units * WIDE)
    ends = view(result, n_out * WIDE)
    command_cells(u, view(p, HEAD.size + n_exact), int(p[HEAD.n_controls]), cells)
    sort_lanes(cells, n_cells, order, ends)
    for row in range(n_states):
        sort_row(view(x, row * LANES), order, view(inputs, row * WIDE))
    for row in range(n_exact):
        sort_row(view(u, int(p[HEAD.size + row]) * LANES), order, view(inputs, (n_states + row) * WIDE))
    serving, weights = view(p, int(p[HEAD.cells])), view(p, int(p[HEAD.weights]))
    begin = 0
    for cell in range(n_cells):
        command = view(weights, int(serving[cell]) * size)
        while begin < int(ends[cell]):
            hidden_layer(view(inputs, begin), n_in, command, view(units, begin), n_units)
            begin += QUARTER
        begin = int(ends[cell])
    for unit in range(n_units):
        squash(view(units, unit * WIDE), LANES)
    begin = 0
    for cell in range(n_cells):
        command = view(weights, int(serving[cell]) * size + n_units * (n_in + 1))
        while begin < int(ends[cell]):
            last_layer(view(units, begin), hidden, command, view(result, begin), n_out)
            begin += QUARTER
        begin = int(ends[cell])
    for row in range(n_out):
        there, here = view(y, row * LANES), view(result, row * WIDE)
        for i in range(LANES):
            there[int(order[i])] = here[i]


def sort_lanes(cells, n_cells, order, ends):
    """Write the lanes in order of their cell, and where each of ``n_cells`` ends."""
    place, before = 0, 0
    for cell in range(n_cells):
        bound, upto = splat_quarter(float(cell) + 0.5), 0
        for first in range(0, LANES, QUARTER):
            upto |= lanes_less(load_quarter(cells, first), bound) << first
        own = upto & ~before
        before = upto
        while own != 0:
            order[place] = first_lane(own)
            own &= own - 1
            place += 1
        ends[cell] = place


def sort_row(row, order, target):
    """Write a row in the order of the lanes."""
    for i in range(LANES):
        target[i] = row[int(order[i])]


def hidden_layer(x, n_in, p, y, n_out):
    """y_j = b_j + sum_i W_ij x_i for sixteen lanes, four units at a time so that a row is read once for all."""
    j = 0
    while j + 4 <= n_out:
        bias = view(p, j)
        a, b = splat_quarter(bias[0]), splat_quarter(bias[1])
        c, d = splat_quarter(bias[2]), splat_quarter(bias[3])
        for i in range(n_in):
            row, w = load_quarter(x, i * WIDE), view(p, (1 + i) * n_out + j)
            a = a + splat_quarter(w[0]) * row
            b = b + splat_quarter(w[1]) * row
            c = c + splat_quarter(w[2]) * row
            d = d + splat_quarter(w[3]) * row
        store(y, j * WIDE, a)
        store(y, (j + 1) * WIDE, b)
        store(y, (j + 2) * WIDE, c)
        store(y, (j + 3) * WIDE, d)
        j += 4
    while j < n_out:
        a = splat_quarter(p[j])
        for i in range(n_in):
            a = a + splat_quarter(p[n_out + i * n_out + j]) * load_quarter(x, i * WIDE)
        store(y, j * WIDE, a)
        j += 1


def last_layer(units, hidden, p, y, n_out):
    """Write every output for sixteen lanes: its bias, and its own units times their weights."""
    for k in range(n_out):
        total, own = splat_quarter(p[k]), k * hidden
        for j in range(hidden):
            total = total + splat_quarter(p[n_out + own + j]) * load_quarter(units, (own + j) * WIDE)
        store(y, k * WIDE, total)
