"""Advice as a cell: what limits the best of the fitted models, and what to record next."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from evaluation.advice import Evidence, ModelAdvice, advice_from_json, advice_to_json, advise_model
from evaluation.comparison.controller_cells import Matrix
from evaluation.comparison.data_cells import Parts
from evaluation.comparison.hand_written import HandWrittenCell
from evaluation.comparison.model_cells import FitCell, PredictCell, read_json, write_json
from evaluation.prediction import ModelPrediction, Prediction, measured_cases
from sysid_evo.data import Trajectory
from sysid_evo.dynamics import DynamicsModel
from sysid_evo.plan import Cell, Work

FORM = 2
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
            return ModelAdvice("", ())
        best = self._best(models, parts, work)
        return advise_model(
            models[best], parts.training, parts.test, visited=self._visited(work), name=best, seed=self.seed
        )

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
        evidence = [Evidence(label, model, parts.training, parts.test) for label, model in models.items()]
        scored = {one.name: one.test_windows.n(one.std) for one in evidence if len(one.test_windows.errors)}
        return min(scored, key=lambda label: scored[label], default=first)

    def _visited(self, work: Work) -> list[Trajectory]:
        """Return what evolved controllers did in their recorded trials, in models and on robots."""
        if self.matrix is None:
            return []
        evolved = [run for run in self.matrix.runs if not isinstance(run.champion, HandWrittenCell)]
        cells = [cell for run in evolved if (cell := work.result(run)) is not None]
        return [trace.trajectory for cell in cells for trace in cell.traces]

    def save(self, value: ModelAdvice, path: Path) -> list[Path]:
        return write_json(advice_to_json(value), path)

    def load(self, path: Path) -> ModelAdvice:
        return advice_from_json(read_json(path))
