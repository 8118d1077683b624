"""Cells that test controllers and models: run, transfer matrix, exploitability, worst exploit, advice."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from evaluation.advice.advise import advise_model
from evaluation.advice.evidence import Evidence, ModelAdvice
from evaluation.cells.controllers import ChampionCell, ControllerFiles, HandWrittenCell, conditions
from evaluation.cells.data import Parts
from evaluation.cells.models import FitCell, PredictCell
from evaluation.cells.plants import BELIEVED, STEPS, Plant, believed
from evaluation.exploitability.assessment import assess_exploitability
from evaluation.exploitability.results import ModelExploitability
from evaluation.exploitability.search import search_exploit
from evaluation.prediction.cases import measured_cases
from evaluation.prediction.scores import ModelPrediction, Prediction
from evaluation.storage import load_result, save_result
from evaluation.transfer.matrix import (
    MeasuredResult,
    TransferMatrix,
    TransferResult,
    run_on,
    transfer_seeds,
    with_measured,
)
from sysid_evo.engine import Runner
from sysid_evo.errors import InvalidArgument, InvalidData
from sysid_evo.evolution import Champion, ControllerEvolution
from sysid_evo.models import DynamicsModel
from sysid_evo.plan import Cell, Outcome, Work, cell_seed
from sysid_evo.registry import controllers, strategies, tasks

ASSESSMENT = 6
"""What is found out about models: results of another number are made anew."""


@dataclass(frozen=True, eq=False)
class RunCell(Cell):
    """Runs a controller on a column in ``trials`` fresh trials, of which ``traces`` are recorded.

    The states are observed as late as they were in evolution.
    """

    kind = "run"

    champion: Cell
    column: Plant
    delay: float
    trials: int
    traces: int
    seed: int

    @property
    def title(self) -> str:
        return f"run {self.champion.name} on {self.column.label}"

    @property
    def group(self) -> str:
        return f"run {self.champion.name}"

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

    def compute(self, work: Work) -> TransferResult:
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

    def save(self, value: TransferResult, path: Path) -> list[Path]:
        return save_result(value, path)

    def load(self, path: Path) -> TransferResult:
        return load_result(TransferResult, path)

    def named(self, value: TransferResult) -> TransferResult:
        return replace(value, champion=self.champion.name, column=self.column.label)

    def seconds(self) -> float:
        return 0.05 + self.trials * STEPS * self.column.step_seconds()


@dataclass(frozen=True)
class Matrix:
    """The cells of a transfer matrix, from which it is put together: rows, columns, and every pair.

    ``robot`` labels the column of the emulated robot, if there is one; ``measured`` are cells driven
    on robots and by people.
    """

    champions: tuple[ChampionCell | HandWrittenCell, ...]
    columns: tuple[Plant, ...]
    runs: tuple[RunCell, ...]
    robot: str | None
    measured: tuple[MeasuredResult, ...] = ()

    def of(self, outcome: Any) -> TransferMatrix | None:
        """Return the matrix of what is there; ``outcome(cell)`` gives the `Outcome` of a cell."""
        champions = [value for cell in self.champions if (value := outcome(cell).value) is not None]
        known = {champion.name for champion in champions}
        cells = []
        for run in self.runs:
            found: Outcome = outcome(run)
            if run.champion.name in known:
                failed = TransferResult(run.champion.name, run.column.label, reason=found.reason or "")
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
        return save_result(value, path)

    def load(self, path: Path) -> tuple[ModelExploitability, ...]:
        return load_result(tuple[ModelExploitability, ...], path)


FORM = 4
"""Raised whenever other advice is given on the same than before."""


@dataclass(frozen=True, eq=False)
class AdviseCell(Cell):
    """Says what limits the model that predicts best, and what to record next; without scores, the first that is fitted.

    Where controllers were evolved, it knows where they go.
    """

    kind = "advise"
    tolerant = True

    data: Cell
    fits: Mapping[str, FitCell]
    predictions: Mapping[str, PredictCell]
    matrix: Matrix | None
    seed: int

    @property
    def title(self) -> str:
        return "advise on the models"

    @property
    def name(self) -> str:
        return "advice"

    @property
    def needs(self) -> tuple[Cell, ...]:
        controllers = () if self.matrix is None else (*self.matrix.champions, *self.matrix.runs)
        return (self.data, *self.fits.values(), *self.predictions.values(), *controllers)

    def inputs(self) -> dict[str, Any]:
        return {"form": FORM, "seed": self.seed, "models": list(self.fits)}

    def compute(self, work: Work) -> ModelAdvice:
        parts: Parts = work.result(self.data)
        models = {label: model for label, fit in self.fits.items() if (model := work.result(fit)) is not None}
        if not models:
            return ModelAdvice("")
        best = self._best(models, parts, work)
        # what evolved controllers did in their recorded trials, in models and on robots
        runs = () if self.matrix is None else self.matrix.runs
        evolved = [run for run in runs if not isinstance(run.champion, HandWrittenCell)]
        cells = [cell for run in evolved if (cell := work.result(run)) is not None]
        visited = [trace.trajectory for cell in cells for trace in cell.traces]
        return advise_model(models[best], parts.training, parts.test, visited=visited, name=best, seed=self.seed)

    def _best(self, models: Mapping[str, DynamicsModel], parts: Parts, work: Work) -> str:
        """Return the label of the model with the lowest N at the main horizon, as far as that is known."""
        first = next(iter(models))
        if parts.test is None:
            return first
        if self.predictions:
            found: dict[str, ModelPrediction] = {
                label: value for label, cell in self.predictions.items() if (value := work.result(cell)) is not None
            }
            protocol = next(iter(self.predictions.values())).protocol
            cases = measured_cases(parts.training, parts.test, protocol)
            ranking = Prediction(cases, tuple(found.values())).ranking(cases.main_horizon)
            return next((one.name for one in ranking if one.name in models), first)
        evidence = [
            Evidence(name=label, model=model, training=parts.training, test=parts.test)
            for label, model in models.items()
        ]
        scored = {one.name: one.test_windows.n(one.std) for one in evidence if len(one.test_windows.errors)}
        return min(scored, key=lambda label: scored[label], default=first)

    def save(self, value: ModelAdvice, path: Path) -> list[Path]:
        return save_result(value, path)

    def load(self, path: Path) -> ModelAdvice:
        return load_result(ModelAdvice, path)


SEARCH = 2
"""How is searched: what another search found is made anew."""


@dataclass(frozen=True, eq=False)
class SearchCell(ControllerFiles):
    """Evolves the controller that gains most in ``target`` beyond the median of those of ``others`` that predict well.

    Raises `InvalidArgument` where there is no other.
    """

    kind = "search"

    target: Plant
    others: tuple[Plant, ...]
    settings: ControllerEvolution
    seed: int

    def __post_init__(self) -> None:
        if not self.others:
            raise InvalidArgument(
                f"exploit: expected models of other families than {self.target.registered} in the run, found none: "
                "fit some more, so that there is something to compare with"
            )

    @property
    def title(self) -> str:
        return f"search the worst exploit of {self.target.label}"

    @property
    def name(self) -> str:
        return f"exploit-of-{self.target.label}"

    @property
    def needs(self) -> tuple[Cell, ...]:
        return (*self.target.needs, *(cell for other in self.others for cell in other.believing))

    def inputs(self) -> dict[str, Any]:
        settings, model = self.settings, self.target.model
        return {
            "target": [self.target.inputs(), None if model is None else model.digest],
            "controller": controllers.identity(settings.controller),
            "task": tasks.identity(settings.task),
            "strategy": strategies.identity(settings.strategy),
            **conditions(settings),
            "generations": settings.generations,
            "believed": BELIEVED,
            "search": SEARCH,
            "seed": self.seed,
        }

    def compute(self, work: Work) -> Champion:
        columns = (self.target, *believed(self.others, work))
        runners: dict[str, Runner] = {column.label: column.runner(work, delay=0.0) for column in columns}
        return search_exploit(
            self.target.label,
            runners,
            self.target.system(work),
            self.settings,
            seed=cell_seed(self.seed, f"search {self.target.registered}"),
            progress=work.progress,
        ).champion

    def seconds(self) -> float:
        return 0.04 * self.settings.generations * (1 + len(self.others))
