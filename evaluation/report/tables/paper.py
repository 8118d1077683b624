"""Table 2 of the paper, from the cells of a comparison with its preset."""

from __future__ import annotations

import numpy as np

from evaluation.report.sheets import Sheet, lines, number
from evaluation.transfer import Cell, TransferMatrix
from evaluation.transfer.measured import BY_HAND
from sysid_evo.evolution import Champion

FAMILIES = {"backprop27": "bp27", "parametrised": "param", "evolved3": "evo3", "nearest_neighbour": "nn"}
"""The columns, and what the paper calls them; the last one is the car."""
CONTROLLERS = {
    ("backprop27",): ("bp27c", (18.6, 9.0, 1.3, 14.0, 9.33)),
    ("parametrised",): ("paramc", (18.1, 15.1, 1.3, 15.5, 14.0)),
    ("evolved3",): ("evo3c", (0.7, 0.2, 13.4, 0.3, 0.33)),
    ("nearest_neighbour",): ("nnc", (15.0, 5.0, 0.7, 17.0, 5.33)),
    ("evolved3", "nearest_neighbour"): ("mm1c", (11.0, 4.0, 15.0, 12.0, 8.33)),
    ("backprop27", "nearest_neighbour", "parametrised"): ("mm2c", (13.6, 10.0, 10.2, 11.7, 9.33)),
}
"""What each controller was evolved against (the paper does not say which three models mm2c met), and its row there."""
HUMANS = "People in the paper: 8.33 waypoints forwards (humFc), 6.0 backwards (humBc)."


def paper_sheet(matrix: TransferMatrix) -> Sheet | None:
    """The paper's Table 2 with these cells, its own numbers below; None unless its four single models are there.

    Several models of one family are not in it: the first counts.
    """
    columns = {family: column for column in reversed(matrix.models) if (family := matrix.families[column]) in FAMILIES}
    if len(columns) < len(FAMILIES):
        return None
    places = [*(columns[family] for family in FAMILIES), *([] if matrix.robot is None else [matrix.robot])]
    rows = []
    for champion in matrix.champions:
        known = CONTROLLERS.get(tuple(sorted(matrix.families.get(name, name) for name in champion.against)))
        if known is not None and set(champion.against) <= set(columns.values()):
            name, published = known
            cells = [matrix.cell(champion.name, place) for place in places]
            rows.append((name, *(_cell(cell, there) for cell, there in zip(cells, published, strict=False))))
    driven = [champion for champion in matrix.champions if champion.controller == BY_HAND]
    rows += [(champion.name, *_by_hand(matrix, champion, places)) for champion in driven]
    return Sheet(
        title="Table 2 of the paper, here and there: fitness (standard deviation)",
        columns=("controller", *FAMILIES.values(), *([] if matrix.robot is None else ["real"])),
        rows=tuple(rows),
        note=(
            "First line: this comparison; second: the paper, whose car, data and arena are others. "
            f"mm1c met evo3 and nn, mm2c here bp27, nn and param. {HUMANS}"
        ),
        details=True,
    )


def _cell(cell: Cell, published: float) -> str:
    there = f"paper {published:g}"
    if cell.failed:
        return lines("–", there)
    spread = f" ({number(cell.std)})" if np.isfinite(cell.std) else ""
    return lines(f"{number(cell.mean)}{spread}", there)


def _by_hand(matrix: TransferMatrix, champion: Champion, places: list[str]) -> list[str]:
    return [number(matrix.cell(champion.name, place).mean) for place in places]
