"""One small network for each command and each output, over lanes (paper, section 4.1).

A weight of all commands is a table of sixteen numbers, or of several pages of sixteen: every lane looks up that of
its own command.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from sysid_evo.arrays import Array, IntArray
from sysid_evo.engine.kernels.commands import command_cells
from sysid_evo.engine.kernels.stepping import copy
from sysid_evo.kernels import (
    CACHE_LINE,
    LANES,
    QUARTER,
    KernelSource,
    Layout,
    Predictor,
    load_quarter,
    look_up,
    padded,
    store,
    view,
    where_less,
)

HEAD = Layout("n_states", "n_exact", "n_controls", "pages", "weights", align=CACHE_LINE)


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
    units = np.concatenate([first_bias[:, :, None], first, second[:, :, None]], axis=2)  # (C, n_out, n_in + 2, hidden)
    of_output = [units.transpose(0, 1, 3, 2).reshape(commands, n_out, -1), second_bias[:, :, None]]
    weights = np.concatenate(of_output, axis=2)[serving]  # (cells, n_out, hidden (n_in + 2) + 1)
    pages = -(-len(serving) // QUARTER)
    table = np.zeros((*weights.shape[1:], pages * QUARTER))
    table[..., : len(serving)] = weights.transpose(1, 2, 0)
    head = padded(np.array(lookup))
    parameters = HEAD.pack(
        head,
        table,
        n_states=n_states,
        n_exact=len(exact),
        n_controls=len(midpoints),
        pages=pages,
        weights=HEAD.size + len(head),
    )
    sizes = {"N_IN": n_in, "HIDDEN": hidden, "N_OUT": n_out}
    return Predictor(KernelSource(command_networks, sizes), parameters, n_scratch=1 + n_in)


def command_networks(x, u, p, y, scratch):
    """Write every output of the networks of each lane's command (a predictor, see `stepping`)."""
    n_states, n_exact, pages = int(p[HEAD.n_states]), int(p[HEAD.n_exact]), int(p[HEAD.pages])
    cells, inputs = scratch, view(scratch, LANES)
    command_cells(u, view(p, HEAD.size + n_exact), int(p[HEAD.n_controls]), cells)
    copy(x, inputs, n_states * LANES)
    for row in range(n_exact):
        copy(view(u, int(p[HEAD.size + row]) * LANES), view(inputs, (n_states + row) * LANES), LANES)
    step = pages * QUARTER
    for lane in range(0, LANES, QUARTER):
        cell, table = load_quarter(cells, lane), view(p, int(p[HEAD.weights]))
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
    """Return every lane's own number from a table with one for each cell."""
    found = look_up(load_quarter(table, 0), min(cell, QUARTER - 1.0))
    for page in range(1, pages):
        place = min(max(cell - float(page * QUARTER), 0.0), QUARTER - 1.0)
        found = where_less(cell, float(page * QUARTER), found, look_up(load_quarter(table, page * QUARTER), place))
    return found
