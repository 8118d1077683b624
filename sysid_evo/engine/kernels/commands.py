"""The cell of every lane's command: which table or network answers for it."""

from __future__ import annotations

from sysid_evo.engine.compiled.lanes import LANES, view


def command_cells(u, p, n_controls, cells):
    """Write the cell of every lane's command.

    Cells are counted like an odometer over the ``n_controls`` controls; ``p`` holds for each control
    the number of boundaries between its levels, then the boundaries, which belong to the lower level.
    """
    for lane in range(LANES):
        cells[lane] = 0.0
    place = 0
    for control in range(n_controls):
        count, row = int(p[place]), view(u, control * LANES)
        for lane in range(LANES):
            cells[lane] *= p[place] + 1.0
        for i in range(count):
            middle = p[place + 1 + i]
            for lane in range(LANES):
                cells[lane] += 1.0 if middle < row[lane] else 0.0
        place += count + 1
