"""A report is made of a plan and a store alone."""

from __future__ import annotations

from evaluation.comparison.planning import Comparison
from evaluation.prediction import ModelPrediction, Prediction, measured_cases
from evaluation.report import DataSummary, Failure, ModelSummary, Report
from sysid_evo.errors import InvalidData
from sysid_evo.plan import Cell, Store
from sysid_evo.store import versions

HELD_BY_THE_MATRIX = ("run",)
"""Kinds of cells whose failures the transfer matrix tells itself."""


def report_of(comparison: Comparison, store: Store) -> Report:
    """Return what ``store`` knows of ``comparison``; what was not computed is told as a failure.

    Raises `InvalidData` if there are no data, or no model was fitted.
    """
    parts = store.outcome(comparison.data)
    if parts.value is None:
        raise InvalidData(f"{comparison.data.title}: {parts.reason}")
    training, test = parts.value.training, parts.value.test
    fitted = {label: store.outcome(fit) for label, fit in comparison.fits.items()}
    models = {label: outcome.value for label, outcome in fitted.items() if outcome.value is not None}
    if not models:
        reasons = "; ".join(f"{label}: {outcome.reason}" for label, outcome in fitted.items())
        raise InvalidData(f"no model could be fitted: {reasons}")
    matrix = None if comparison.matrix is None else comparison.matrix.of(store.outcome)
    found = None if comparison.exploitability is None else store.outcome(comparison.exploitability).value
    return Report(
        title=comparison.title,
        data=DataSummary.of(training, training if test is None else test),
        models=tuple(
            ModelSummary.of(label, model, family=comparison.fits[label].spec.name) for label, model in models.items()
        ),
        prediction=_prediction(comparison, store),
        matrix=matrix,
        exploitability=() if found is None or matrix is None else found,
        failures=tuple(_failures(comparison, store)),
        settings=comparison.experiment.model_dump(mode="json", exclude_none=True),
        versions=versions(),
        timings={cell.title: store.outcome(cell).seconds for cell in comparison.plan},
    )


def _prediction(comparison: Comparison, store: Store) -> Prediction | None:
    """Return the prediction errors of all models, those that failed with their reason."""
    if not comparison.predictions:
        return None
    parts = store.outcome(comparison.data).value
    rows = []
    for label, cell in comparison.predictions.items():
        outcome = store.outcome(cell)
        if outcome.value is not None:
            rows.append(outcome.value)
        elif label not in comparison.fits or store.outcome(comparison.fits[label]).value is not None:
            rows.append(ModelPrediction(label, cell.family, reason=outcome.reason or ""))
    protocol = next(iter(comparison.predictions.values())).protocol
    return Prediction(measured_cases(parts.training, parts.test, protocol), tuple(rows))


def _failures(comparison: Comparison, store: Store) -> list[Failure]:
    """Return the cells that failed themselves; those that only needed one of them are left out."""
    found = []
    for cell in comparison.plan:
        record = store.find(cell.digest)
        told = cell.kind in HELD_BY_THE_MATRIX or cell.kind == "predict"
        if record is not None and record.status == "failed" and not told:
            found.append(Failure(cell.title, record.reason or ""))
        elif record is None and not told and not _blocked(cell, store):
            found.append(Failure(cell.title, store.outcome(cell).reason or ""))
    return found


def _blocked(cell: Cell, store: Store) -> bool:
    return any(store.outcome(needed).value is None for needed in cell.needs)
