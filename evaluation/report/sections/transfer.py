"""Fitness of every controller on every system: the transfer matrix, further measures, Table 2 of the paper."""

from __future__ import annotations

import numpy as np

from evaluation.formatting import by_error, folded, lines, number, percent, plus_minus, three_digits
from evaluation.report.document import Interval, Number, Numbers, Part
from evaluation.report.elements import Shading, TableElement
from evaluation.transfer.matrix import BY_HAND, NOT_RUN, TransferMatrix, TransferResult
from evaluation.transfer.summary import MatrixEstimates
from sysid_evo.evolution import Champion
from sysid_evo.evolution.aggregates import mean
from sysid_evo.validation.estimates import CONFIDENCE, estimate_of

CONSENSUS = "other\nfamilies"
"""Heading of the median over models of other families."""


def transfer_sheet(matrix: TransferMatrix) -> TableElement:
    """Return mean fitness (standard deviation over trials) of every controller on every system.

    The robot comes first, then the median over models of other families, then the models.
    """
    places = _with_consensus(matrix)
    columns = tuple(
        CONSENSUS if c is None else lines(folded(c), "(robot)" if c == matrix.robot else "") for c in places
    )
    figures = MatrixEstimates(matrix)
    medians = {champion.name: estimate_of(figures.other_families(champion)) for champion in matrix.champions}
    median = {name: np.nan if found is None else found.value for name, found in medians.items()}
    rows = [
        (
            champion.name,
            *(
                plus_minus(medians[champion.name])
                if c is None
                else _fitness_cell(matrix.cell(champion.name, c), c in champion.against)
                for c in places
            ),
        )
        for champion in matrix.champions
    ]
    unit, counts = matrix.unit or "fitness", sorted({cell.trials for cell in matrix.cells.values() if cell.trials})
    trials = f"{matrix.trials} fresh trials, the same in every cell."
    if len(counts) > 1:  # on a robot that is driven there may be fewer
        trials = f"{counts[0]} to {counts[-1]} fresh trials, the first ones the same in every cell."
    means = np.array([median[row] if c is None else matrix.cell(row, c).mean for row in matrix.rows for c in places])
    means = means.reshape(len(matrix.rows), len(places))
    known = means[np.isfinite(means)]
    low, top = min(0.0, known.min(initial=0.0)), known.max(initial=0.0)
    shades = tuple(
        tuple((m - low) / (top - low) if np.isfinite(m) and top > low else None for m in row) for row in means
    )
    own = frozenset(
        (i, j)
        for i, champion in enumerate(matrix.champions)
        for j, column in enumerate(places)
        if column in champion.against
    )
    robots = sum(column is not None and column not in matrix.models for column in places)
    ran = [cell for cell in matrix.cells.values() if not cell.failed]
    explained = {
        " Rows are controllers, columns are systems.": True,
        " = evolved in this model.": bool(own),
        " Other families: median over the models of families that it was not evolved in.": None in places,
        " Limited: steps at which a state was held at the state bounds.": any(cell.clipped_share > 0.0 for cell in ran),
        " Div: trials that diverged.": any(cell.diverged_share > 0.0 for cell in ran),
        " Missing: trials that the robot did not finish.": any(cell.missing for cell in ran),
    }
    return TableElement(
        title=f"Transfer matrix: {unit}, mean (standard deviation over trials)",
        columns=("controller", *columns),
        rows=tuple(rows),
        note=trials + "".join(sentence for sentence, needed in explained.items() if needed),
        heat=Shading(shades, own, robots if 0 < robots < len(places) else None),
        sticky=2 if robots else 1,
    )


def _with_consensus(matrix: TransferMatrix) -> tuple[str | None, ...]:
    """Return the columns, robots first; None is the median over other families, if there are several."""
    families = {matrix.families[column] for column in matrix.models}
    robots = tuple(column for column in matrix.columns if column not in matrix.models)
    return (*robots, *((None,) if len(families) > 2 else ()), *matrix.models)


def _fitness_cell(cell: TransferResult, own: bool) -> str:
    if cell.failed:
        return "–" if cell.reason == NOT_RUN else "failed"
    error = cell.standard_error
    return lines(
        f"{'= ' if own else ''}{by_error(cell.mean, error)} ({by_error(cell.std, error)})",
        f"limited {percent(cell.clipped_share)}" if cell.clipped_share > 0 else "",
        f"div {percent(cell.diverged_share)}" if cell.diverged_share > 0 else "",
        f"{len(cell.missing)} missing" if cell.missing else "",
    )


def further_measures_table(matrix: TransferMatrix) -> TableElement | None:
    """Return measures of the task other than fitness, in the first model evolved in and on the robot; None if none."""
    rows, names = [], list(dict.fromkeys(name for cell in matrix.cells.values() for name in cell.measures))
    for champion in matrix.champions:
        own = next((column for column in champion.against if column in matrix.columns), None)
        places = dict.fromkeys(column for column in (own, matrix.robot) if column is not None)
        for column in places:
            measures = matrix.cell(champion.name, column).measures
            shown = [three_digits(measures.get(name)) for name in names]
            rows.append((champion.name, folded(column), *shown))
    if not names:
        return None
    return TableElement(
        title="Other measures of the task",
        columns=("controller", "on", *(name.replace(" ", "\n") for name in names)),
        rows=tuple(rows),
        note="Means over the trials that have the measure, in the first model evolved in and on the robot.",
        details=True,
    )


FAMILIES = {"backprop27": "bp27", "parametrised": "param", "evolved3": "evo3", "nearest_neighbour": "nn"}
"""The columns and their names in the paper."""
CONTROLLERS = {
    ("backprop27",): ("bp27c", (18.6, 9.0, 1.3, 14.0, 9.33)),
    ("parametrised",): ("paramc", (18.1, 15.1, 1.3, 15.5, 14.0)),
    ("evolved3",): ("evo3c", (0.7, 0.2, 13.4, 0.3, 0.33)),
    ("nearest_neighbour",): ("nnc", (15.0, 5.0, 0.7, 17.0, 5.33)),
    ("evolved3", "nearest_neighbour"): ("mm1c", (11.0, 4.0, 15.0, 12.0, 8.33)),
    ("backprop27", "nearest_neighbour", "parametrised"): ("mm2c", (13.6, 10.0, 10.2, 11.7, 9.33)),
}
"""Row of the paper for each controller, by its models; the paper does not name the three models of mm2c."""
HUMANS = "People in the paper: 8.33 waypoints forwards (humFc), 6.0 backwards (humBc)."


def paper_sheet(matrix: TransferMatrix) -> TableElement | None:
    """Return Table 2 of the paper with these results, its own numbers below; None without its four models.

    Of several models of one family the first is used.
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
            row = [name]
            for place, there in zip(places, published, strict=False):
                cell = matrix.cell(champion.name, place)
                spread = f" ({number(cell.std)})" if np.isfinite(cell.std) else ""
                row.append(lines("–" if cell.failed else f"{number(cell.mean)}{spread}", f"paper {there:g}"))
            rows.append(tuple(row))
    driven = [champion.name for champion in matrix.champions if champion.controller == BY_HAND]
    rows += [(name, *(number(matrix.cell(name, place).mean) for place in places)) for name in driven]
    return TableElement(
        title="Table 2 of the paper, with the results of this run: fitness (standard deviation)",
        columns=("controller", *FAMILIES.values(), *([] if matrix.robot is None else ["real"])),
        rows=tuple(rows),
        note=(
            "First line: this run; second line: the paper, with another car, other data and another arena. "
            f"mm1c was evolved in evo3 and nn, mm2c of this run in bp27, nn and param. {HUMANS}"
        ),
        details=True,
    )


class CellPart(Part):
    """One controller on one system, over fresh trials; ``reason`` is why there are none."""

    controller: str
    column: str
    trials: int
    mean: Number
    std: Number
    standard_error: Number
    interval: Interval | None
    clipped_share: Number
    diverged_share: Number
    engine: str
    fitness: Numbers
    reason: str | None
    missing: tuple[str, ...]

    @classmethod
    def of(cls, champion: Champion, column: str, figures: MatrixEstimates) -> CellPart:
        """Return a cell of the matrix with the interval of its mean."""
        cell, figure = figures.matrix.cell(champion.name, column), figures.on(champion, [column], mean)
        interval = None if figure is None else figure.estimate.interval
        return cls.made_of(cell, controller=champion.name, interval=interval, reason=cell.reason or None)


class TransferPart(Part):
    """The transfer matrix: rows are controllers, columns are systems; cells row by row.

    ``interval`` is the share of the cases that the intervals contain.
    """

    unit: str
    trials: int
    rows: tuple[str, ...]
    columns: tuple[str, ...]
    robot: str | None
    other_robots: tuple[str, ...]
    families: dict[str, str]
    interval: float
    cells: tuple[CellPart, ...]

    @classmethod
    def of(cls, matrix: TransferMatrix) -> TransferPart:
        """Return a matrix with intervals."""
        figures = MatrixEstimates(matrix)
        cells = [CellPart.of(one, column, figures) for one in matrix.champions for column in matrix.columns]
        return cls.made_of(matrix, interval=CONFIDENCE, cells=cells)
