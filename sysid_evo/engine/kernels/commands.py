"""The cell of every lane's command: which table or network answers for it."""

from __future__ import annotations

from sysid_evo.kernels import LANES, load, splat, store, where_less


def command_cells(u, p, n_controls, cells):
    """Write the cell of every lane's command.

    Cells are counted like an odometer over the ``n_controls`` controls; ``p`` holds for each control
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
