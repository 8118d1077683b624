"""Reads what a store holds of a study, point by point, so that little is in memory at a time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from evaluation.comparison import Comparison
from evaluation.comparison.champion_cells import ChampionCell
from evaluation.comparison.hand_written import HandWrittenCell
from evaluation.exploitability import ModelExploitability
from evaluation.forecast import Forecast, error_of, forecasts, highest
from evaluation.prediction import ErrorScore, ModelPrediction
from evaluation.study.planning import PlannedStudy
from evaluation.study.results import (
    CellTime,
    ControllerRow,
    Error,
    Failed,
    Kind,
    ModelRow,
    PointRow,
    StudyResults,
)
from evaluation.study.study import Point
from evaluation.transfer import AT_REST, Standing, TransferMatrix, is_exploited, standings
from sysid_evo.plan import Cell, Record, Store
from sysid_evo.plan.store import WAITING
from sysid_evo.registry import Spec, tasks
from sysid_evo.store import versions


def gather(planned: PlannedStudy, folder: Path) -> StudyResults:
    """Return all that the store in ``folder`` knows of a study; nothing is computed."""
    points: list[PointRow] = []
    models: list[ModelRow] = []
    controllers: list[ControllerRow] = []
    failures: dict[str, Failed] = {}
    times: dict[str, CellTime] = {}
    for point, comparison in planned.points:
        one = _Gathered(point, comparison, Store(folder), {})
        one.records.update({cell.digest: one.store.find(cell.digest) for cell in comparison.plan})
        for cell in comparison.plan:
            record = one.records[cell.digest]
            if record is not None:
                times[cell.digest] = CellTime(cell.kind, record.seconds, record.status == "failed")
            if record is not None and record.status == "failed":
                failures.setdefault(cell.digest, Failed(point.name, cell.title, record.reason or ""))
        rows = list(one.controllers())
        points.append(one.row(next((row.controller for row in rows if row.chosen), "")))
        models += one.models()
        controllers += rows
    return StudyResults(
        study=planned.study,
        points=tuple(points),
        models=tuple(models),
        controllers=with_yardsticks(points, controllers),
        failures=tuple(failures.values()),
        times=tuple(times.values()),
        versions=versions(),
    )


@dataclass(frozen=True)
class _Gathered:
    """One point, its comparison, and what ``store`` knows of it; ``records`` are by digest."""

    point: Point
    comparison: Comparison
    store: Store
    records: dict[str, Record | None]

    def row(self, chosen: str) -> PointRow:
        """Return how far the point is."""
        states = [self._state(cell) for cell in self.comparison.plan]
        task = self.comparison.experiment.task
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
        """Yield a row for each model that was tried, the failed ones with their reason."""
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
                family=fit.spec.name,
                errors=() if prediction is None else tuple(_error(score) for score in prediction.at),
                exploited=None if one is None else one.exploited,
                claimed=None if one is None or one.claimed is None else one.claimed.value,
                achieved=None if one is None or one.achieved is None else one.achieved.value,
                kept=None if one is None or one.kept is None else one.kept.value,
                seconds=None if record is None or record.status == "failed" else record.seconds,
                reason=self._reason(fit),
            )

    def controllers(self) -> Iterator[ControllerRow]:
        """Yield a row for each controller that was tried, the failed ones with their reason."""
        planned = self.comparison.matrix
        matrix = None if planned is None else planned.of(self.store.outcome)
        if planned is None:
            return
        errors = {label: error_of(self._value(cell)) for label, cell in self.comparison.predictions.items()}
        ran = {cell.name for cell in planned.champions if self._all_ran(cell)}
        found = {} if matrix is None else forecasts(matrix, errors)
        found = {name: forecast for name, forecast in found.items() if name in ran}
        resting = None if matrix is None else _at_rest(matrix)
        standing = {} if matrix is None else standings(matrix, resting)
        floor = None if matrix is None or resting is None else _achieved(matrix, resting)
        finished = all(self._state(cell) != "missing" for cell in self.comparison.plan)
        in_models = [
            cell.name for cell in planned.champions if self._kind(cell) in ("single", "ensemble", "recommended")
        ]
        chosen = highest(found, in_models) if finished else None
        for cell in planned.champions:
            if self._state(cell) == "missing":
                continue
            row = self._controller(cell, standing.get(cell.name), found.get(cell.name), errors)
            achieved = None if matrix is None else _achieved(matrix, cell.name)
            yield replace(row, achieved=achieved, floor=floor, chosen=cell.name == chosen)

    def _controller(
        self,
        cell: ChampionCell | HandWrittenCell,
        standing: Standing | None,
        forecast: Forecast | None,
        errors: dict[str, float | None],
    ) -> ControllerRow:
        members = tuple(member.label for member in cell.members)
        known = [error for name in members if (error := errors.get(name)) is not None]
        row = ControllerRow(
            point=self.point.name,
            controller=cell.name,
            kind=self._kind(cell),
            members=members,
            aggregate=self.comparison.experiment.aggregate if len(members) > 1 else "",
            error=float(np.mean(known)) if known else None,
            file="" if self.records[cell.digest] is None else f"{self._where(cell)}.json",
            reason=self._reason(cell),
        )
        if standing is not None:
            claimed, worst, achieved = standing.claimed, standing.worst, standing.achieved
            on_robot = self.comparison.matrix is not None and self.comparison.matrix.robot is not None
            row = replace(
                row,
                claimed=None if claimed is None else claimed.value,
                achieved_error=achieved.standard_error if achieved is not None and on_robot else None,
                worst=None if worst is None else worst.value,
                worst_on=standing.worst_on,
                exploited=is_exploited(claimed, standing.gap) if row.in_models else None,
                expected=forecast.holds(achieved) if forecast and achieved and on_robot else None,
            )
        if forecast is not None:
            row = replace(row, forecast=forecast.value, forecast_low=forecast.low, forecast_high=forecast.high)
        return row

    def _kind(self, cell: ChampionCell | HandWrittenCell) -> Kind:
        if isinstance(cell, HandWrittenCell):
            return "by hand"
        if cell.kind == "polish":
            return "recommended"
        if any(member.robot is not None for member in cell.members):
            return "robot"
        return "single" if len(cell.members) == 1 else "ensemble"

    def _all_ran(self, cell: ChampionCell | HandWrittenCell) -> bool:
        """Whether a controller was tried on every system, so that nothing in its forecast is still to come."""
        matrix = self.comparison.matrix
        runs = () if matrix is None else matrix.runs
        return all(self._state(run) != "missing" for run in runs if run.champion is cell)

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

    def _where(self, cell: Cell) -> str:
        return self.store.where(cell).relative_to(self.store.path).as_posix()


def with_yardsticks(points: list[PointRow], rows: list[ControllerRow]) -> tuple[ControllerRow, ...]:
    """Return ``rows`` with the yardsticks of their robots, and the shares of these that they achieve."""
    place = {point.name: (point.where, point.task) for point in points}
    best: dict[tuple[str, str], float] = {}
    for row in rows:
        if row.achieved is not None and np.isfinite(row.achieved):
            key = place[row.point]
            best[key] = max(best.get(key, -np.inf), row.achieved)
    return tuple(_with_share(row, best.get(place[row.point])) for row in rows)


def _with_share(row: ControllerRow, yardstick: float | None) -> ControllerRow:
    floor = row.floor or 0.0
    if row.achieved is None or yardstick is None or yardstick <= floor:
        return replace(row, yardstick=yardstick)
    return replace(row, yardstick=yardstick, share=(row.achieved - floor) / (yardstick - floor))


def _at_rest(matrix: TransferMatrix) -> str | None:
    found = (one.name for one in matrix.champions if one.controller.name == AT_REST and not one.against)
    return next(found, None)


def _achieved(matrix: TransferMatrix, controller: str) -> float | None:
    """Return the mean fitness on the robot, None where it was not run there."""
    if matrix.robot is None or controller not in matrix.rows:
        return None
    cell = matrix.cell(controller, matrix.robot)
    return None if cell.failed else cell.mean


def _error(score: ErrorScore) -> Error:
    assert score.horizon is not None
    return Error(score.horizon, score.n, score.interval.low, score.interval.high)
