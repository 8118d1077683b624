"""Cells that test controllers and models: run, transfer matrix, exploitability, worst exploit, advice."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from evaluation.advice.advise import advise_model
from evaluation.advice.evidence import ModelAdvice
from evaluation.cells.controllers import CONTROLLERS, Baseline, ControllerCell, identity_of
from evaluation.cells.data import SplitDataset
from evaluation.cells.models import PROTOCOL, Fit, Predict, ScoreFit
from evaluation.cells.plants import ACCURATE, STEPS, Plant, accurate_plants, labels_of, runners
from evaluation.exploitability.assessment import assess_exploitability
from evaluation.exploitability.results import ModelExploitability
from evaluation.exploitability.search import search_exploit
from evaluation.prediction.cases import measured_cases
from evaluation.prediction.scores import Prediction
from evaluation.storage import result_of
from evaluation.transfer.matrix import (
    MeasuredResult,
    TransferMatrix,
    TransferResult,
    run_controller,
    transfer_seeds,
    with_measured,
)
from sysid_evo.errors import InvalidArgument, InvalidData
from sysid_evo.evolution import Champion, ControllerEvolution
from sysid_evo.models import DynamicsModel
from sysid_evo.plan import CELL_KINDS, Cell, CellContext, CellKind, CellOutcome, CellSettings, cell_seed


@dataclass(frozen=True)
class Run(CellSettings):
    """Run of a controller on a column in ``trials`` fresh trials, of which ``traces`` are recorded.

    The states are observed with the same delay as in evolution. ``steps`` is the expected length of a trial.
    """

    champion: ControllerCell
    column: Plant
    delay: float
    trials: int
    traces: int
    seed: int
    steps: int = STEPS

    def cell(self) -> Cell[Run]:
        champion, column = self.champion.name, self.column.label
        return Cell(
            kind="run",
            name=f"{champion}@{column}",
            title=f"run {champion} on {column}",
            settings=self,
            needs=(self.champion, *self.column.needs),
            labels={"champion": champion, "column": column},
            group=f"run {champion}",
            expected_seconds=0.05 + self.trials * self.steps * self.column.step_seconds(),
        )

    def inputs(self) -> dict[str, Any]:
        return {
            "column": self.column.inputs(),
            "delay": self.delay,
            "trials": self.trials,
            "traces": self.traces,
            "seed": self.seed,
        }

    def compute(self, work: CellContext) -> TransferResult:
        champion: Champion = work.result(self.champion)
        champion.check_system(self.column.system(work))
        cell = run_controller(
            champion,
            self.column.label,
            self.column.runner(work, delay=self.delay, reported=True),
            transfer_seeds(self.seed, self.trials),
            traces=self.traces,
        )
        if cell.failed:
            raise InvalidData(cell.reason)
        return cell


@dataclass(frozen=True)
class PlannedMatrix:
    """Cells of a transfer matrix: rows, columns, and every pair of them.

    ``robot`` is the label of the column of the emulated robot, if there is one; ``measured`` are results of
    recorded drives on robots and by people.
    """

    controllers: tuple[ControllerCell, ...]
    columns: tuple[Plant, ...]
    runs: tuple[Cell[Run], ...]
    robot: str | None
    measured: tuple[MeasuredResult, ...] = ()

    def of(self, outcome: Callable[[Cell], CellOutcome]) -> TransferMatrix | None:
        """Return the matrix of all finished cells; ``outcome(cell)`` gives the `CellOutcome` of a cell."""
        champions = [value for cell in self.controllers if (value := outcome(cell).value) is not None]
        known = {champion.name for champion in champions}
        cells = []
        for cell in self.runs:
            found, run = outcome(cell), cell.settings
            if run.champion.name in known:
                failed = TransferResult(run.champion.name, run.column.label, reason=found.reason or "")
                cells.append(failed if found.value is None else found.value)
        families = {column.label: column.family for column in self.columns}
        matrix = TransferMatrix.of(champions, labels_of(self.columns), cells, families=families, robot=self.robot)
        return with_measured(matrix if champions else None, self.measured)


@dataclass(frozen=True)
class AssessExploitability(CellSettings):
    """Assessment of how each model is exploited by the controllers that were evolved on it."""

    matrix: PlannedMatrix
    data: Cell

    def cell(self) -> Cell[AssessExploitability]:
        matrix = self.matrix
        return Cell(
            kind="exploit",
            name="exploitability",
            title="assess exploitability",
            settings=self,
            needs=(self.data, *matrix.controllers, *matrix.runs),
            expected_seconds=1.0 * len(matrix.columns),
        )

    def inputs(self) -> dict[str, Any]:
        return {
            "columns": [[column.label, column.family] for column in self.matrix.columns],
            "rows": [champion.name for champion in self.matrix.controllers],
            "robot": self.matrix.robot,
            "measured": [measured.digest for measured in self.matrix.measured],
        }

    def compute(self, work: CellContext) -> tuple[ModelExploitability, ...]:
        parts = work.result(self.data)

        def outcome(cell: Cell) -> CellOutcome:
            value = work.result(cell)
            return CellOutcome(value, None if value is not None else f"{cell.title} failed", 0.0)

        matrix = self.matrix.of(outcome)
        if matrix is None:
            return ()
        return assess_exploitability(matrix, parts.training, parts.test)


@dataclass(frozen=True)
class Advise(CellSettings):
    """Advice on what limits the most accurate model, and what to record next; without scores, on the first model.

    If controllers were evolved, it includes where they go. ``scores`` are those of models without predictions.
    """

    data: Cell
    fits: Mapping[str, Cell[Fit]]
    predictions: Mapping[str, Cell[Predict]]
    matrix: PlannedMatrix | None
    seed: int
    scores: Mapping[str, Cell[ScoreFit]] = field(default_factory=dict)

    def cell(self) -> Cell[Advise]:
        controllers = () if self.matrix is None else (*self.matrix.controllers, *self.matrix.runs)
        return Cell(
            kind="advise",
            name="advice",
            title="advise on the models",
            settings=self,
            needs=(
                self.data,
                *self.fits.values(),
                *self.predictions.values(),
                *controllers,
                *self.scores.values(),
            ),
        )

    def inputs(self) -> dict[str, Any]:
        return {"seed": self.seed, "models": list(self.fits)}

    def compute(self, work: CellContext) -> ModelAdvice:
        parts: SplitDataset = work.result(self.data)
        models = {label: model for label, fit in self.fits.items() if (model := work.result(fit)) is not None}
        if not models:
            return ModelAdvice("")
        best = self._best(models, parts, work)
        # the recorded trials of evolved controllers, in models and on robots
        runs = () if self.matrix is None else self.matrix.runs
        evolved = [run for run in runs if not isinstance(run.settings.champion.settings, Baseline)]
        cells = [cell for run in evolved if (cell := work.result(run)) is not None]
        visited = [trace.trajectory for cell in cells for trace in cell.traces]
        return advise_model(models[best], parts.training, parts.test, visited=visited, name=best, seed=self.seed)

    def _best(self, models: Mapping[str, DynamicsModel], parts: SplitDataset, work: CellContext) -> str:
        """Return the label of the model with the lowest known N at the main horizon."""
        first = next(iter(models))
        scores = {label: score for label, cell in self.scores.items() if (score := work.result(cell)) is not None}
        errors = {label: score.n for label, score in scores.items() if label in models and score.n is not None}
        if errors or parts.test is None:
            return min(errors, key=lambda label: errors[label], default=first)
        found = [value for cell in self.predictions.values() if (value := work.result(cell)) is not None]
        cases = measured_cases(parts.training, parts.test, PROTOCOL)
        ranking = Prediction(cases, tuple(found)).ranking(cases.main_horizon)
        return next((one.name for one in ranking if one.name in models), first)


@dataclass(frozen=True)
class SearchExploit(CellSettings):
    """Evolution of the controller that gains most in ``target`` over the median of the accurate ones of ``others``.

    Raises `InvalidArgument` if there are no others.
    """

    target: Plant
    others: tuple[Plant, ...]
    evolution: ControllerEvolution
    seed: int

    def __post_init__(self) -> None:
        if not self.others:
            raise InvalidArgument(
                f"exploit: expected models of other families than {self.target.registered} in the run, found none: "
                "fit some more, so that there is something to compare with"
            )

    def cell(self) -> Cell[SearchExploit]:
        return Cell(
            kind="search",
            name=f"exploit-of-{self.target.label}",
            title=f"search the worst exploit of {self.target.label}",
            settings=self,
            needs=(*self.target.needs, *(cell for other in self.others for cell in other.needs_with_prediction)),
            expected_seconds=0.04 * self.evolution.generations * (1 + len(self.others)),
        )

    def inputs(self) -> dict[str, Any]:
        return {
            "target": self.target.inputs(),
            **identity_of(self.evolution),
            "accurate": ACCURATE,
            "seed": self.seed,
        }

    def compute(self, work: CellContext) -> Champion:
        return search_exploit(
            self.target.label,
            runners((self.target, *accurate_plants(self.others, work)), work),
            self.target.system(work),
            self.evolution,
            seed=cell_seed(self.seed, f"search {self.target.registered}"),
            progress=work.progress,
        ).champion


CELL_KINDS["run"] = CellKind(result_of(TransferResult))
CELL_KINDS["exploit"] = CellKind(result_of(tuple[ModelExploitability, ...]), version=3, tolerant=True)
CELL_KINDS["advise"] = CellKind(result_of(ModelAdvice), tolerant=True)
CELL_KINDS["search"] = CellKind(CONTROLLERS, version=2)
