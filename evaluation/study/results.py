"""Results of a study: rows, read from the store point by point, and their Parquet tables."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np

from evaluation.cells.controllers import ControllerCell
from evaluation.cells.plants import labels_of
from evaluation.experiment import DEFAULT_TASK
from evaluation.exploitability.results import ModelExploitability, outside_shares
from evaluation.planning import Comparison
from evaluation.prediction.scores import ErrorScore, ModelPrediction, error_of, forecast_error
from evaluation.study.planning import PlannedStudy
from evaluation.study.study import Point, Study
from evaluation.transfer.forecast import Forecast, best_choice, forecasts
from evaluation.transfer.matrix import TransferMatrix
from evaluation.transfer.summary import ControllerSummary, summarise
from sysid_evo.display import Displayed
from sysid_evo.files import write_atomically
from sysid_evo.plan import Cell, CellRecord, Store
from sysid_evo.plan.store import WAITING
from sysid_evo.registry import Spec, tasks
from sysid_evo.version import versions

ControllerKind: TypeAlias = Literal["single", "ensemble", "polished", "robot", "baseline"]
"""Origin of a controller: one model, several at once, polish on all of them, the robot itself, or a baseline."""
IN_MODELS = ("single", "ensemble", "polished")


@dataclass(frozen=True)
class HorizonError:
    """N of a model ``horizon`` steps ahead, with its 95 % interval over the test data; it has no unit."""

    horizon: int
    n: float
    low: float
    high: float


@dataclass(frozen=True)
class ModelRow:
    """One fitted model of one point, or the ``reason`` why there is none.

    ``claimed`` and ``achieved`` are means over the controllers that were evolved in it, ``kept`` is the share of the
    claim that is achieved, ``exploited`` whether the claim is exploited. ``seconds`` is the duration of the fit.
    """

    point: str
    model: str
    family: str
    errors: tuple[HorizonError, ...] = ()
    exploited: bool | None = None
    claimed: float | None = None
    achieved: float | None = None
    kept: float | None = None
    seconds: float | None = None
    reason: str = ""

    def n(self, horizon: int) -> float | None:
        """Return N at a horizon, None if it was not measured."""
        return next((error.n for error in self.errors if error.horizon == horizon), None)


@dataclass(frozen=True)
class ControllerRow:
    """One controller of one point, or the ``reason`` why there is none; fitness is in the unit of the point's task.

    ``achieved`` is the fitness on the robot; ``worst`` that on ``worst_on``, the system where it is lowest among all
    that it was not evolved against. ``within_forecast`` is true if ``achieved`` is in the 90 % interval of the
    forecast. ``error`` is the mean N after a second of the models that it was evolved in. ``best_known`` is the best
    fitness achieved on this robot in the study. ``normalised`` is the achieved share of it, both measured from
    ``rest_fitness``, that of controls at rest, if those were run.
    """

    point: str
    controller: str
    kind: ControllerKind
    members: tuple[str, ...]
    aggregate: str = ""
    claimed: float | None = None
    achieved: float | None = None
    achieved_error: float | None = None
    forecast: float | None = None
    forecast_low: float | None = None
    forecast_high: float | None = None
    within_forecast: bool | None = None
    worst: float | None = None
    worst_on: str = ""
    error: float | None = None
    exploited: bool | None = None
    rest_fitness: float | None = None
    best_known: float | None = None
    normalised: float | None = None
    chosen: bool = False
    file: str = ""
    reason: str = ""

    @property
    def in_models(self) -> bool:
        """Whether it was evolved in models, and is neither from the robot itself nor a baseline."""
        return self.kind in IN_MODELS


@dataclass(frozen=True)
class PointRow:
    """One point: how many of its ``cells`` are done, failed and ``missing``, and which controller is ``chosen``.

    ``where`` is its robot or its recordings, ``group`` the labels of the axes that distinguish rows of a table.
    """

    name: str
    labels: Mapping[str, str]
    where: str
    seed: str
    group: tuple[str, ...]
    cells: int
    done: int
    failed: int
    missing: int
    task: str = ""
    unit: str = ""
    chosen: str = ""

    @property
    def finished(self) -> bool:
        """Whether all of its cells have been computed."""
        return self.missing == 0


@dataclass(frozen=True)
class FailedCell:
    """A cell that failed, its point, and the reason."""

    point: str
    cell: str
    reason: str


@dataclass(frozen=True)
class CellTime:
    """Duration of one cell that was computed, once for all points that need it."""

    kind: str
    seconds: float
    failed: bool = False


@dataclass(frozen=True, repr=False)
class StudyResults(Displayed):
    """Results of a study, from its plan and its store alone."""

    study: Study
    points: tuple[PointRow, ...]
    models: tuple[ModelRow, ...] = ()
    controllers: tuple[ControllerRow, ...] = ()
    failures: tuple[FailedCell, ...] = ()
    times: tuple[CellTime, ...] = ()
    versions: Mapping[str, str] = field(default_factory=dict)

    def facts(self) -> Mapping[str, str]:
        rows = {"models": self.models, "controllers": self.controllers, "failures": self.failures}
        counts = {what: str(len(found)) for what, found in rows.items()}
        return {"title": self.study.title, "points": f"{len(self.finished)} of {len(self.points)} finished", **counts}

    @property
    def finished(self) -> tuple[PointRow, ...]:
        """The points with no missing cells."""
        return tuple(point for point in self.points if point.finished)

    def point(self, name: str) -> PointRow:
        """Return the point of this name."""
        return next(point for point in self.points if point.name == name)


def gather_study(planned: PlannedStudy, folder: Path) -> StudyResults:
    """Return the results of a study in the store in ``folder``; nothing is computed."""
    points: list[PointRow] = []
    models: list[ModelRow] = []
    controllers: list[ControllerRow] = []
    failures: dict[str, FailedCell] = {}
    times: dict[str, CellTime] = {}
    for point, comparison in planned.points:
        one = _Gathered(point, comparison, Store(folder), {})
        one.records.update({cell.digest: one.store.find(cell.digest) for cell in comparison.plan})
        for cell in comparison.plan:
            record = one.records[cell.digest]
            if record is not None:
                times[cell.digest] = CellTime(cell.kind, record.seconds, record.status == "failed")
            if record is not None and record.status == "failed":
                failures.setdefault(cell.digest, FailedCell(point.name, cell.title, record.reason or ""))
        rows = list(one.controllers())
        points.append(one.row(next((row.controller for row in rows if row.chosen), "")))
        models += one.models()
        controllers += rows
    return StudyResults(
        study=planned.study,
        points=tuple(points),
        models=tuple(models),
        controllers=with_best_known(points, controllers),
        failures=tuple(failures.values()),
        times=tuple(times.values()),
        versions=versions(),
    )


@dataclass(frozen=True)
class _Gathered:
    """One point, its comparison, and its ``store``; ``records`` are by digest."""

    point: Point
    comparison: Comparison
    store: Store
    records: dict[str, CellRecord | None]

    def row(self, chosen: str) -> PointRow:
        """Return the progress of the point."""
        states = [self._state(cell) for cell in self.comparison.plan]
        task = self.comparison.experiment.task or DEFAULT_TASK
        return PointRow(
            name=self.point.name,
            labels=self.point.labels,
            where=self.point.where,
            seed=self.point.labels.get("seed", str(self.comparison.experiment.seed)),
            group=self.point.group,
            cells=len(states),
            done=states.count("done"),
            failed=states.count("failed"),
            missing=states.count("missing"),
            task=task,
            unit=str(getattr(tasks.get(Spec.parse(task).name), "fitness_unit", "")),
            chosen=chosen,
        )

    def models(self) -> Iterator[ModelRow]:
        """Yield a row for each model that was tried, failed ones with their reason."""
        found = self._value(self.comparison.exploitability)
        assessed: dict[str, ModelExploitability] = {one.model: one for one in found or ()}
        for label, fit in self.comparison.fits.items():
            record = self.records[fit.digest]
            if record is None and self._state(fit) == "missing":
                continue
            prediction: ModelPrediction | None = self._value(self.comparison.predictions.get(label))
            one = assessed.get(label)
            yield ModelRow(
                point=self.point.name,
                model=label,
                family=fit.settings.spec.name,
                errors=() if prediction is None else tuple(_error(score) for score in prediction.scores),
                exploited=None if one is None else one.exploited,
                claimed=None if one is None or one.claimed is None else one.claimed.value,
                achieved=None if one is None or one.achieved is None else one.achieved.value,
                kept=None if one is None or one.kept is None else one.kept.value,
                seconds=None if record is None or record.status == "failed" else record.seconds,
                reason=self._reason(fit),
            )

    def controllers(self) -> Iterator[ControllerRow]:
        """Yield a row for each controller that was tried, failed ones with their reason."""
        planned = self.comparison.matrix
        if planned is None:
            return
        predicted = {label: self._value(cell) for label, cell in self.comparison.predictions.items()}
        errors = {label: error_of(one) for label, one in predicted.items()}
        summaries: dict[str, ControllerSummary] = {}
        found: dict[str, Forecast] = {}
        chosen, rest_fitness = None, None
        matrix = planned.of(self.store.outcome)
        if matrix is not None:
            weighted = {label: forecast_error(one) for label, one in predicted.items()}
            waiting = [run.settings.champion for run in planned.runs if self._state(run) == "missing"]
            ran = {cell.name for cell in planned.controllers if not any(cell is one for one in waiting)}
            exploits = self._value(self.comparison.exploitability)
            expected = forecasts(matrix, weighted, outside_shares(exploits or ()))
            found = {name: forecast for name, forecast in expected.items() if name in ran}
            summaries = {one.name: one for one in summarise(matrix).controllers}
            rest_fitness = _achieved(matrix, matrix.at_rest[0]) if matrix.at_rest else None
            finished = all(self._state(cell) != "missing" for cell in self.comparison.plan)
            chosen = best_choice(matrix, found) if finished else None
        for cell in planned.controllers:
            if self._state(cell) == "missing":
                continue
            row = self._controller(cell, summaries.get(cell.name), found.get(cell.name), errors)
            achieved = None if matrix is None else _achieved(matrix, cell.name)
            yield replace(row, achieved=achieved, rest_fitness=rest_fitness, chosen=cell.name == chosen)

    def _controller(
        self,
        cell: ControllerCell,
        summary: ControllerSummary | None,
        forecast: Forecast | None,
        errors: dict[str, float | None],
    ) -> ControllerRow:
        members, kind, on_robot = labels_of(cell.settings.members), self._kind(cell), None
        known = [error for name in members if (error := errors.get(name)) is not None]
        matrix, record = self.comparison.matrix, self.records[cell.digest]
        file = f"{self.store.result_path(cell).relative_to(self.store.path).as_posix()}.json"
        if summary is not None and matrix is not None and matrix.robot is not None:
            on_robot = summary.elsewhere
        return ControllerRow(
            point=self.point.name,
            controller=cell.name,
            kind=kind,
            members=members,
            aggregate=self.comparison.experiment.aggregate if len(members) > 1 else "",
            claimed=None if summary is None or summary.claimed is None else summary.claimed.value,
            achieved_error=None if on_robot is None else on_robot.standard_error,
            forecast=None if forecast is None else forecast.value,
            forecast_low=None if forecast is None else forecast.low,
            forecast_high=None if forecast is None else forecast.high,
            within_forecast=None if forecast is None or on_robot is None else forecast.covers(on_robot),
            worst=None if summary is None or summary.worst is None else summary.worst.value,
            worst_on="" if summary is None else summary.worst_on,
            error=float(np.mean(known)) if known else None,
            exploited=summary.exploited if summary is not None and kind in IN_MODELS else None,
            file="" if record is None else file,
            reason=self._reason(cell),
        )

    def _kind(self, cell: ControllerCell) -> ControllerKind:
        if cell.kind == "baseline":
            return "baseline"
        if cell.kind == "polish":
            return "polished"
        if any(member.robot is not None for member in cell.settings.members):
            return "robot"
        return "single" if len(cell.settings.members) == 1 else "ensemble"

    def _state(self, cell: Cell) -> str:
        record = self.records[cell.digest]
        if record is not None:
            return record.status
        return "missing" if self.store.outcome(cell).reason == WAITING else "failed"

    def _reason(self, cell: Cell) -> str:
        record = self.records[cell.digest]
        return "" if record is not None and record.status == "done" else self.store.outcome(cell).reason or ""

    def _value(self, cell: Cell | None) -> Any:
        return None if cell is None else self.store.outcome(cell).value


def with_best_known(points: list[PointRow], rows: list[ControllerRow]) -> tuple[ControllerRow, ...]:
    """Return ``rows`` with the best known fitness of their robots, and their fitness normalised by it."""
    place = {point.name: (point.where, point.task) for point in points}
    best: dict[tuple[str, str], float] = {}
    for row in rows:
        if row.achieved is not None and np.isfinite(row.achieved):
            key = place[row.point]
            best[key] = max(best.get(key, -np.inf), row.achieved)
    found = []
    for row in rows:
        best_known, rest_fitness = best.get(place[row.point]), row.rest_fitness or 0.0
        normalised = row.normalised
        if row.achieved is not None and best_known is not None and best_known > rest_fitness:
            normalised = (row.achieved - rest_fitness) / (best_known - rest_fitness)
        found.append(replace(row, best_known=best_known, normalised=normalised))
    return tuple(found)


def _achieved(matrix: TransferMatrix, controller: str) -> float | None:
    """Return the mean fitness on the robot, None if it was not run there."""
    if matrix.robot is None or controller not in matrix.rows:
        return None
    cell = matrix.cell(controller, matrix.robot)
    return None if cell.failed else cell.mean


def _error(score: ErrorScore) -> HorizonError:
    assert score.horizon is not None
    return HorizonError(score.horizon, score.n, *score.estimate.interval)


POINT_COLUMNS = {
    "point": "name of the point",
    "where": "robot, or recordings",
    "cells": "cells of the point, shared ones included",
    "done": "cells that are done",
    "failed": "cells that failed, or could not be computed because one they need failed",
    "missing": "cells that are not computed yet",
    "task": "task",
    "unit": "unit of fitness",
    "chosen": "controller chosen by its forecast; empty for none",
}
MODEL_COLUMNS = {
    "point": "name of the point",
    "model": "label of the model",
    "family": "registered name of its family",
    "exploited": "whether claims made in it exceed the achieved fitness by a tenth and by two standard errors",
    "claimed": "mean claim of the controllers evolved in it, unit of fitness",
    "achieved": "mean fitness of these controllers on the robot, unit of fitness",
    "kept": "share of the claim that is achieved",
    "seconds": "duration of the fit, s",
    "reason": "why there is no model; empty for none",
}
N_COLUMNS = {
    "n_{}": "N after {} steps: mean over channels of RMSE / standard deviation, on held-out data",
    "n_{}_low": "lower end of its 95 % interval (block bootstrap)",
    "n_{}_high": "upper end of its 95 % interval (block bootstrap)",
}
CONTROLLER_COLUMNS = {
    "point": "name of the point",
    "controller": "name of the controller",
    "kind": "single, ensemble, polished, robot (evolved on it) or baseline",
    "members": "models that it was planned to be evolved against, joined by +",
    "aggregate": "rule by which the fitness on several models becomes one number",
    "claimed": "fitness where it was evolved, unit of fitness",
    "achieved": "fitness on the robot, unit of fitness",
    "achieved_error": "standard error of that over trials, unit of fitness",
    "forecast": "expected fitness on the robot, unit of fitness",
    "forecast_low": "lower end of the 90 % interval of the forecast, unit of fitness",
    "forecast_high": "upper end of the 90 % interval of the forecast, unit of fitness",
    "within_forecast": "whether the achieved fitness is in that interval",
    "worst": "lowest fitness on a system that it was not evolved against, unit of fitness",
    "worst_on": "that system",
    "error": "mean N after 20 steps of its members",
    "exploited": "whether its claim exceeds the achieved fitness by a tenth and by two standard errors",
    "rest_fitness": "fitness of controls at rest, unit of fitness; missing if fitness begins at 0",
    "best_known": "best achieved on this robot in the study, unit of fitness",
    "normalised": "(achieved - rest_fitness) / (best_known - rest_fitness)",
    "chosen": "whether it is chosen by its forecast",
    "file": "its file in the folder of the study",
    "reason": "why there is none; empty for none",
}
CELL_COLUMNS = {
    "kind": "kind of work",
    "seconds": "duration, s",
    "failed": "whether it failed",
}


AXIS = "axis_{}"
"""The column of an axis; the prefix keeps it distinct from all others."""


def save_parquet(results: StudyResults, folder: Path) -> tuple[Path, ...]:
    """Write ``points``, ``models``, ``controllers`` and ``cells.parquet`` into ``folder``; return the files."""
    axes = {AXIS.format(axis): f"label of the value of {axis}" for axis in results.study.axes}
    horizons = sorted({error.horizon for row in results.models for error in row.errors})
    errors = {name.format(h): text.format(h) for h in horizons for name, text in N_COLUMNS.items()}
    labels = {point.name: {AXIS.format(a): text for a, text in point.labels.items()} for point in results.points}
    points = [{**asdict(point), **labels[point.name], "point": point.name} for point in results.points]
    models = []
    for row in results.models:
        models.append({**asdict(row), **labels[row.point]})
        for error in row.errors:
            names = [name.format(error.horizon) for name in N_COLUMNS]
            models[-1].update(zip(names, (error.n, error.low, error.high), strict=True))
    controllers = [
        {**asdict(row), **labels[row.point], "members": "+".join(row.members)} for row in results.controllers
    ]
    return (
        _write(folder / "points.parquet", points, {**POINT_COLUMNS, **axes}),
        _write(folder / "models.parquet", models, {**MODEL_COLUMNS, **axes, **errors}),
        _write(folder / "controllers.parquet", controllers, {**CONTROLLER_COLUMNS, **axes}),
        _write(folder / "cells.parquet", [asdict(time) for time in results.times], CELL_COLUMNS),
    )


def _write(path: Path, rows: Sequence[Mapping[str, Any]], columns: Mapping[str, str]) -> Path:
    """Write the ``columns`` of ``rows``; the meaning of each is the description of its field."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pa.table({name: pa.array([row.get(name) for row in rows]) for name in columns})
    fields = [table.schema.field(name).with_metadata({"description": text}) for name, text in columns.items()]
    table = table.cast(pa.schema(fields))
    return write_atomically(path, lambda file: pq.write_table(table, file))
