"""How well each model predicts."""

from __future__ import annotations

from evaluation.report.absences import of_prediction
from evaluation.report.contents import Report
from evaluation.report.pictures import free_run_picture, horizon_picture
from evaluation.report.sections.section import Section, present
from evaluation.report.tables import (
    channel_sheet,
    condition_sheet,
    coverage_sheet,
    difference_sheet,
    episode_error_sheet,
    fit_sheet,
    prediction_sheet,
    region_sheet,
    residual_sheet,
)

LOW_ERROR = "A low prediction error does not show that a controller evolved in the model works elsewhere: see Transfer."


def section(report: Report) -> Section:
    """Return errors, their curves, and where they are; without any, why."""
    prediction = report.prediction
    if prediction is None:
        return Section("Prediction", absent=of_prediction(report))
    scored = [model for model in prediction.models if not model.failed]
    return Section(
        "Prediction",
        present(
            prediction_sheet(prediction),
            coverage_sheet(prediction),
            condition_sheet(report.conditions),
            difference_sheet(prediction),
            horizon_picture(prediction) if prediction.cases.horizons else None,
            free_run_picture(prediction) if prediction.cases.free_runs and scored else None,
            region_sheet(prediction),
            residual_sheet(prediction),
            episode_error_sheet(prediction),
            fit_sheet(prediction),
            *(channel_sheet(prediction, horizon) for horizon in reversed(prediction.horizons)),
        ),
        [LOW_ERROR] if report.matrix is not None else [],
        absent=of_prediction(report),
    )
