"""A card per model: equations, parameters with standard errors, poles."""

from __future__ import annotations

from evaluation.formatting import listed
from evaluation.report.elements import Sheet
from evaluation.results import Report


def model_sheet(report: Report) -> Sheet:
    """The models and their hyper-parameters."""
    rows = [
        (model.name, model.family, model.knowledge, listed([f"{k} = {v}" for k, v in model.parameters.items()]))
        for model in report.models
    ]
    heads = ("model", "family", "knowledge", "hyper-parameters")
    return Sheet("Models", heads, tuple(rows), details=True, prose=True)
