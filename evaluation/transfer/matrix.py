"""The transfer matrix: every controller (row) on every system (column)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from evaluation.transfer.cell import NOT_RUN, Cell, kept_traces, run_cell, transfer_seeds
from sysid_evo.arrays import Array
from sysid_evo.dynamics import Dynamics
from sysid_evo.engine import Runner, as_runners
from sysid_evo.errors import InvalidArgument
from sysid_evo.evolution import Champion
from sysid_evo.progress import Progress
from sysid_evo.randomness import as_seed


@dataclass(frozen=True)
class TransferMatrix:
    """Cells by row and column; the ``robot``, if there is one, is the last column.

    ``families`` names the family of each model column, and of other models that a controller was evolved against, if it
    is known. ``other_robots`` are columns that are neither
    models nor the robot whose fitness counts as achieved.
    """

    champions: tuple[Champion, ...]
    columns: tuple[str, ...]
    cells: Mapping[tuple[str, str], Cell]
    families: Mapping[str, str]
    robot: str | None = None
    other_robots: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        champions: Sequence[Champion],
        columns: Sequence[str],
        cells: Iterable[Cell],
        *,
        families: Mapping[str, str] | None = None,
        robot: str | None = None,
        other_robots: Sequence[str] = (),
    ) -> TransferMatrix:
        """Put ``cells`` in their places; a missing one was not run. Raises `InvalidArgument`."""
        names = [champion.name for champion in champions]
        for what, listed in (("controllers", names), ("columns", list(columns))):
            repeated = sorted({name for name in listed if listed.count(name) > 1})
            if repeated:
                raise InvalidArgument(f"transfer: names of {what} must differ, repeated: {', '.join(repeated)}")
        last = (*other_robots, *((robot,) if robot is not None else ()))
        for name in last:
            if name not in columns:
                raise InvalidArgument(f"transfer: the robot {name!r} is not among the columns {', '.join(columns)}")
        ordered = (*(c for c in columns if c not in last), *last)
        placed = {(cell.champion, cell.column): cell for cell in cells}
        for name in names:
            for column in ordered:
                placed.setdefault((name, column), Cell(name, column, reason=NOT_RUN))
        given = families or {}
        named = {**given, **{column: given.get(column, column) for column in ordered}}
        return cls(tuple(champions), ordered, placed, named, robot, tuple(other_robots))

    @property
    def rows(self) -> tuple[str, ...]:
        return tuple(champion.name for champion in self.champions)

    @property
    def models(self) -> tuple[str, ...]:
        """The columns that are not robots."""
        return tuple(column for column in self.columns if column not in (self.robot, *self.other_robots))

    @property
    def unit(self) -> str:
        """The unit of fitness."""
        return next((cell.unit for cell in self.cells.values() if cell.unit), "")

    @property
    def trials(self) -> int:
        """The largest number of trials in a cell."""
        return max((cell.trials for cell in self.cells.values()), default=0)

    def cell(self, champion: str, column: str) -> Cell:
        return self.cells[champion, column]

    def means(self) -> Array:
        """Mean fitness (rows, columns), nan for a failed cell."""
        return np.array([[self.cell(row, column).mean for column in self.columns] for row in self.rows]).reshape(
            len(self.rows), len(self.columns)
        )

    def stds(self) -> Array:
        """Standard deviation over trials (rows, columns), nan for a failed cell."""
        return np.array([[self.cell(row, column).std for column in self.columns] for row in self.rows]).reshape(
            len(self.rows), len(self.columns)
        )

    def best(self, column: str) -> str | None:
        """Return the evolved controller with the highest mean fitness on ``column``."""
        evolved = [champion.name for champion in self.champions if champion.against]
        known = [row for row in evolved if not self.cell(row, column).failed]
        return max(known, key=lambda row: self.cell(row, column).mean, default=None)

    def failures(self) -> tuple[Cell, ...]:
        """Return the cells that were tried and failed, row by row."""
        cells = (self.cell(row, column) for row in self.rows for column in self.columns)
        return tuple(cell for cell in cells if cell.failed and cell.reason != NOT_RUN)


def transfer(
    champions: Sequence[Champion],
    runners: Mapping[str, Runner | Dynamics],
    *,
    seed: int,
    families: Mapping[str, str] | None = None,
    robot: str | None = None,
    trials: int = 100,
    traces: int = 10,
    progress: Progress | None = None,
) -> TransferMatrix:
    """Run every champion on every runner, or model, in the same fresh trials.

    ``robot`` names the runner that is the robot, if one is. The first ``traces`` trials are kept, see `kept_traces`.
    """
    runners, seeds = as_runners(runners, "transfer"), transfer_seeds(as_seed(seed), trials)
    cells = []
    for champion in champions:
        for column, runner in runners.items():
            kept = kept_traces(traces, own=column == robot or column in champion.against)
            cells.append(run_cell(champion, column, runner, seeds, traces=kept))
            if progress is not None:
                progress(len(cells), len(champions) * len(runners))
    return TransferMatrix.of(champions, tuple(runners), cells, families=families, robot=robot)
