"""Cells of controllers on columns: running one, the transfer matrix, how models are exploited."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from evaluation.comparison.champion_cells import ChampionCell
from evaluation.comparison.columns import Column
from evaluation.comparison.hand_written import HandWrittenCell
from evaluation.comparison.model_cells import read_json, write_json
from evaluation.exploitability import (
    ModelExploitability,
    assess_exploitability,
    exploitability_from_json,
    exploitability_to_json,
)
from evaluation.transfer import Cell as MatrixCell
from evaluation.transfer import (
    Measured,
    TransferMatrix,
    load_cell,
    run_on,
    save_cell,
    transfer_seeds,
    with_measured,
)
from sysid_evo.errors import InvalidData
from sysid_evo.evolution import Champion
from sysid_evo.plan import Cell, Outcome, Work

ASSESSMENT = 5
"""What is found out about models: results of another number are made anew."""


@dataclass(frozen=True, eq=False)
class RunCell(Cell):
    """Runs a controller on a column in ``trials`` fresh trials, of which ``traces`` are recorded.

    The states are observed as late as they were in evolution.
    """

    kind = "run"

    champion: Cell
    column: Column
    delay: float
    trials: int
    traces: int
    seed: int

    @property
    def title(self) -> str:
        return f"run {self.champion.name} on {self.column.label}"

    @property
    def name(self) -> str:
        return f"{self.champion.name}@{self.column.label}"

    @property
    def needs(self) -> tuple[Cell, ...]:
        return (self.champion, *self.column.needs)

    def inputs(self) -> dict[str, Any]:
        return {
            "column": self.column.inputs(),
            "delay": self.delay,
            "trials": self.trials,
            "traces": self.traces,
            "seed": self.seed,
        }

    def compute(self, work: Work) -> MatrixCell:
        champion: Champion = work.result(self.champion)
        champion.check_system(self.column.system(work))
        cell = run_on(
            champion,
            self.column.label,
            self.column.runner(work, delay=self.delay),
            transfer_seeds(self.seed, self.trials),
            traces=self.traces,
        )
        if cell.failed:
            raise InvalidData(cell.reason)
        return cell

    def save(self, value: MatrixCell, path: Path) -> list[Path]:
        return save_cell(value, path)

    def load(self, path: Path) -> MatrixCell:
        return load_cell(path)

    def named(self, value: MatrixCell) -> MatrixCell:
        return replace(value, champion=self.champion.name, column=self.column.label)

    def seconds(self) -> float:
        return 0.05


@dataclass(frozen=True)
class Matrix:
    """The cells of a transfer matrix, from which it is put together: rows, columns, and every pair.

    ``robot`` labels the column of the emulated robot, if there is one; ``measured`` are cells driven
    on robots and by people.
    """

    champions: tuple[ChampionCell | HandWrittenCell, ...]
    columns: tuple[Column, ...]
    runs: tuple[RunCell, ...]
    robot: str | None
    measured: tuple[Measured, ...] = ()

    def of(self, outcome: Any) -> TransferMatrix | None:
        """Return the matrix of what is there; ``outcome(cell)`` gives the `Outcome` of a cell."""
        champions = [value for cell in self.champions if (value := outcome(cell).value) is not None]
        known = {champion.name for champion in champions}
        cells = []
        for run in self.runs:
            found: Outcome = outcome(run)
            if run.champion.name in known:
                failed = MatrixCell(run.champion.name, run.column.label, reason=found.reason or "")
                cells.append(failed if found.value is None else found.value)
        families = {column.label: column.family for column in self.columns}
        labels = tuple(column.label for column in self.columns)
        matrix = TransferMatrix.of(champions, labels, cells, families=families, robot=self.robot)
        return with_measured(matrix if champions else None, self.measured)


@dataclass(frozen=True, eq=False)
class ExploitCell(Cell):
    """Assesses how each model is exploited by the controllers that were evolved on it."""

    kind = "exploit"
    tolerant = True

    matrix: Matrix
    data: Cell
    seed: int

    @property
    def title(self) -> str:
        return "assess exploitability"

    @property
    def name(self) -> str:
        return "exploitability"

    @property
    def needs(self) -> tuple[Cell, ...]:
        models = (cell for column in self.matrix.columns for cell in column.needs)
        return (self.data, *self.matrix.champions, *self.matrix.runs, *models)

    def inputs(self) -> dict[str, Any]:
        return {
            "assessment": ASSESSMENT,
            "seed": self.seed,
            "columns": [[column.label, column.family] for column in self.matrix.columns],
            "rows": [champion.name for champion in self.matrix.champions],
            "robot": self.matrix.robot,
            "measured": [measured.digest for measured in self.matrix.measured],
        }

    def compute(self, work: Work) -> tuple[ModelExploitability, ...]:
        parts = work.result(self.data)

        def outcome(cell: Cell) -> Outcome:
            value = work.result(cell)
            return Outcome(value, None if value is not None else f"{cell.title} failed", 0.0)

        matrix = self.matrix.of(outcome)
        if matrix is None:
            return ()
        found = {one.label: work.result(one.model) for one in self.matrix.columns if one.model is not None}
        models = {label: model for label, model in found.items() if model is not None}
        return assess_exploitability(matrix, parts.training, parts.test, models=models, seed=self.seed)

    def seconds(self) -> float:
        return 1.0 * len(self.matrix.columns)

    def save(self, value: tuple[ModelExploitability, ...], path: Path) -> list[Path]:
        return write_json([exploitability_to_json(model) for model in value], path)

    def load(self, path: Path) -> tuple[ModelExploitability, ...]:
        return tuple(exploitability_from_json(model) for model in read_json(path))
