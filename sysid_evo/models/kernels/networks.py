"""Networks over lanes: one, the mean of several, and one for each command."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np

from sysid_evo.errors import InvalidArgument, ShapeError
from sysid_evo.kernels import (
    CACHE_LINE,
    LANES,
    QUARTER,
    KernelSource,
    Layout,
    Predictor,
    load,
    load_quarter,
    look_up,
    splat,
    store,
    view,
    where_less,
)
from sysid_evo.models.kernels.stepping import copy, move_rows
from sysid_evo.types import Array, IntArray, check_shape

NETWORKS = Layout("n_networks", "n_layers", "n_carry", "n_control", "rectified")

Layers: TypeAlias = Sequence[tuple[Array, Array]]
"""Weights (n_in, n_out) and bias (n_out,) of every layer; hidden layers are tanh, the last is linear."""


def network_predictor(
    networks: Sequence[Layers], n_carry: int, n_control: int, *, rectified: bool = False
) -> Predictor:
    """Return a predictor of the mean output of several networks of one shape.

    Their inputs are ``n_carry`` rows of the carry, then ``n_control`` of the control. The hidden units of ``rectified``
    networks are max(x, 0) instead of tanh x.
    """
    sizes = [networks[0][0][0].shape[0], *(weights.shape[1] for weights, _ in networks[0])]
    if sizes[0] != n_carry + n_control or any(
        [weights.shape[1] for weights, _ in layers] != sizes[1:] for layers in networks
    ):
        raise InvalidArgument(f"networks: expected {n_carry} + {n_control} inputs and equal shapes, got {sizes}")
    flat = []
    for layers in networks:
        for (weights, bias), n_in, n_out in zip(layers, sizes, sizes[1:], strict=False):
            flat += [check_shape("bias", bias, (n_out,)), check_shape("weights", weights, (n_in, n_out)).ravel()]
    parameters = NETWORKS.pack(
        sizes,
        *flat,
        n_networks=len(networks),
        n_layers=len(sizes) - 1,
        n_carry=n_carry,
        n_control=n_control,
        rectified=rectified,
    )
    reads = (n_carry, n_control)
    return Predictor(network, parameters, n_scratch=sizes[0] + 3 * max(sizes), reads=reads, writes=sizes[-1])


def network(x, u, p, y, scratch):
    """Write the mean output of all networks (a predictor, see `stepping`)."""
    n_networks = int(p[NETWORKS.n_networks])
    room, weights = view(scratch, gather(x, u, p, scratch)), view(p, NETWORKS.size + int(p[NETWORKS.n_layers]) + 1)
    n_out = int(p[NETWORKS.size + int(p[NETWORKS.n_layers])])
    weights = view(weights, forward(p, weights, scratch, room, y))
    if n_networks > 1:
        other = view(room, 2 * widest(p) * LANES)
        for _ in range(1, n_networks):
            weights = view(weights, forward(p, weights, scratch, room, other))
            move_rows(y, other, 1.0, y, n_out)
        share = 1.0 / float(n_networks)
        for i in range(n_out * LANES):
            y[i] *= share


def gather(x, u, p, scratch):
    """Write the inputs of the networks to the head of ``scratch``; return their end."""
    n_carry, n_control = int(p[NETWORKS.n_carry]), int(p[NETWORKS.n_control])
    copy(x, scratch, n_carry * LANES)
    copy(u, view(scratch, n_carry * LANES), n_control * LANES)
    return (n_carry + n_control) * LANES


def widest(p):
    """Return the number of rows of the widest layer."""
    rows = 0
    for layer in range(int(p[NETWORKS.n_layers]) + 1):
        rows = max(rows, int(p[NETWORKS.size + layer]))
    return rows


def forward(p, weights, inputs, room, y):
    """Write the output of one network; return the number of its weights."""
    n_layers, even, place = int(p[NETWORKS.n_layers]), room, 0
    odd = view(room, widest(p) * LANES)
    for layer in range(n_layers):
        n_in, n_out = int(p[NETWORKS.size + layer]), int(p[NETWORKS.size + layer + 1])
        source = inputs if layer == 0 else (even if layer % 2 == 1 else odd)
        if layer == n_layers - 1:
            dense(source, n_in, view(weights, place), y, n_out)
        else:
            target = even if layer % 2 == 0 else odd
            dense(source, n_in, view(weights, place), target, n_out)
            if p[NETWORKS.rectified] > 0.0:
                rectify(target, n_out * LANES)
            else:
                squash(target, n_out * LANES)
        place += n_out * (n_in + 1)
    return place


def squash(x, count):
    """Replace ``count`` numbers, whole rows, by their tanh."""
    for first in range(0, count, LANES):
        store(x, first, math.tanh(load(x, first)))


def rectify(x, count):
    """Replace ``count`` numbers, whole rows, by 0 if they are negative."""
    for first in range(0, count, LANES):
        store(x, first, max(load(x, first), 0.0))


def dense(x, n_in, p, y, n_out):
    """y_j = b_j + sum_i W_ij x_i for every lane, four outputs at a time so that a row is read once for all."""
    j = 0
    while j + 4 <= n_out:
        bias = view(p, j)
        a, b, c, d = splat(bias[0]), splat(bias[1]), splat(bias[2]), splat(bias[3])
        for i in range(n_in):
            row, w = load(x, i * LANES), view(p, (1 + i) * n_out + j)
            a = a + splat(w[0]) * row
            b = b + splat(w[1]) * row
            c = c + splat(w[2]) * row
            d = d + splat(w[3]) * row
        store(y, j * LANES, a)
        store(y, (j + 1) * LANES, b)
        store(y, (j + 2) * LANES, c)
        store(y, (j + 3) * LANES, d)
        j += 4
    while j < n_out:
        a = splat(p[j])
        for i in range(n_in):
            a = a + splat(p[n_out + i * n_out + j]) * load(x, i * LANES)
        store(y, j * LANES, a)
        j += 1


# One small network for each command and each output (paper, section 4.1). A weight of all commands is a table of
# sixteen numbers, or of several pages of sixteen: every lane looks up that of its own command.

COMMANDS = Layout("n_states", "n_exact", "n_controls", "pages", "weights", align=CACHE_LINE)


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
    check_shape("first", first, (None, None, n_states + len(exact), None))
    check_shape("first_bias", first_bias, (commands, n_out, hidden))
    check_shape("second", second, (commands, n_out, hidden))
    check_shape("second_bias", second_bias, (commands, n_out))
    n_control = check_cells(serving, commands, midpoints, exact)
    lookup = [float(i) for i in exact]
    for between in midpoints:
        lookup += [len(between), *between]
    units = np.concatenate([first_bias[:, :, None], first, second[:, :, None]], axis=2)  # (C, n_out, n_in + 2, hidden)
    of_output = [units.transpose(0, 1, 3, 2).reshape(commands, n_out, -1), second_bias[:, :, None]]
    weights = np.concatenate(of_output, axis=2)[serving]  # (cells, n_out, hidden (n_in + 2) + 1)
    pages = -(-len(serving) // QUARTER)
    table = np.zeros((*weights.shape[1:], pages * QUARTER))
    table[..., : len(serving)] = weights.transpose(1, 2, 0)
    parameters = COMMANDS.pack(
        lookup,
        n_states=n_states,
        n_exact=len(exact),
        n_controls=len(midpoints),
        pages=pages,
        weights=table,
    )
    sizes = {"N_IN": n_in, "HIDDEN": hidden, "N_OUT": n_out}
    source, reads = KernelSource(command_networks, sizes), (n_states, n_control)
    return Predictor(source, parameters, n_scratch=1 + n_in, reads=reads, writes=n_out)


def check_cells(serving: IntArray, count: int, midpoints: Sequence[Array], exact: Sequence[int]) -> int:
    """Return the number of controls. Raises `ShapeError` unless ``serving`` has one of ``count`` tables per cell."""
    check_shape("serving", serving, (math.prod(len(between) + 1 for between in midpoints),))
    if serving.min() < 0 or serving.max() >= count or min(exact, default=0) < 0:
        raise ShapeError(f"serving: expected numbers of {count} tables, got {serving.min()} to {serving.max()}")
    return max(len(midpoints), 1 + max(exact, default=-1))


def command_networks(x, u, p, y, scratch):
    """Write every output of the networks of each lane's command (a predictor, see `stepping`)."""
    n_states, n_exact, pages = int(p[COMMANDS.n_states]), int(p[COMMANDS.n_exact]), int(p[COMMANDS.pages])
    cells, inputs = scratch, view(scratch, LANES)
    command_cells(u, view(p, COMMANDS.size + n_exact), int(p[COMMANDS.n_controls]), cells)
    copy(x, inputs, n_states * LANES)
    for row in range(n_exact):
        copy(view(u, int(p[COMMANDS.size + row]) * LANES), view(inputs, (n_states + row) * LANES), LANES)
    step = pages * QUARTER
    for lane in range(0, LANES, QUARTER):
        cell, table = load_quarter(cells, lane), view(p, int(p[COMMANDS.weights]))
        for output in range(N_OUT):
            total = own(view(table, HIDDEN * (N_IN + 2) * step), cell, pages)
            for _ in range(HIDDEN):
                unit = own(table, cell, pages)
                for i in range(N_IN):
                    unit = unit + own(view(table, (1 + i) * step), cell, pages) * load_quarter(inputs, i * LANES + lane)
                total = total + own(view(table, (1 + N_IN) * step), cell, pages) * math.tanh(unit)
                table = view(table, (N_IN + 2) * step)
            store(y, output * LANES + lane, total)
            table = view(table, step)


def own(table, cell, pages):
    """Return the number of every lane's cell from a table with one number for each cell."""
    found = look_up(load_quarter(table, 0), min(cell, QUARTER - 1.0))
    for page in range(1, pages):
        place = min(max(cell - float(page * QUARTER), 0.0), QUARTER - 1.0)
        found = where_less(cell, float(page * QUARTER), found, look_up(load_quarter(table, page * QUARTER), place))
    return found


def command_cells(u, p, n_controls, cells):
    """Write the cell of every lane's command.

    Cells are numbered like an odometer over the ``n_controls`` controls; ``p`` holds for each control
    the number of boundaries between its levels, then the boundaries, which belong to the lower level.
    """
    total, one, zero = splat(0.0), splat(1.0), splat(0.0)
    place = 0
    for control in range(n_controls):
        count, value = int(p[place]), load(u, control * LANES)
        total = total * splat(p[place] + 1.0)
        for i in range(count):
            total = total + where_less(splat(p[place + 1 + i]), value, one, zero)
        place += count + 1
    store(cells, 0, total)
