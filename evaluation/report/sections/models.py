"""A card for each model: error, trust, equations, parameters with standard errors, candidates, hyper-parameters."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from evaluation.formatting import by_error, three_digits
from evaluation.report.elements import Fold, Item, Section, TableElement
from evaluation.report.sections.exploitability import trust_of
from evaluation.results import ComparisonResults, ModelSummary


def section(report: ComparisonResults) -> Section | None:
    """Return a folded card for each model, None without models."""
    if not report.models:
        return None
    cards = [Fold(_line(model, report), list(_parts(model))) for model in report.models]
    return Section("Models", cards, background=True)


def _line(model: ModelSummary, report: ComparisonResults) -> str:
    """Return name, error, trust and knowledge of a model in one line."""
    prediction, parts = report.prediction, []
    if prediction is not None and model.name in prediction.names:
        score = prediction.model(model.name).score(prediction.cases.main_horizon)
        parts += [] if score is None else [f"N {three_digits(score.n)}"]
    for found in report.exploitability:
        if found.model == model.name:
            trusted, reasons = trust_of(found, report)
            parts.append(
                {True: "trusted", False: f"not trusted ({'; '.join(reasons)})", None: "trust not known"}[trusted]
            )
    return f"{model.name}: {', '.join([*parts, f'{model.knowledge} box'])}"


def _parts(model: ModelSummary) -> Iterator[Item]:
    if model.equations:
        sides = tuple(tuple(line.split(" = ", 1)) for line in model.equations)
        yield TableElement(f"Equations of {model.name}", ("of", "equation"), sides, prose=True)
    if model.parameters_table:
        rows = tuple(_parameter(row) for row in model.parameters_table)
        heads = ("parameter", "value ± standard error", "unit", "bounds", "determined\nby the data")
        yield TableElement(f"Parameters of {model.name}", heads, rows)
    if model.candidates:
        keys = tuple(dict.fromkeys(key for row in model.candidates for key in row))
        rows = tuple(tuple(row.get(key, "–") for key in keys) for row in model.candidates)
        yield TableElement(f"Candidates of {model.name}", keys, rows, prose=True)
    settings = [("family", model.family), *((name, str(value)) for name, value in model.parameters.items())]
    yield TableElement(f"Hyper-parameters of {model.name}", ("name", "value"), tuple(settings), prose=True)


def _parameter(row: Mapping[str, Any]) -> tuple[str, ...]:
    """Return a row of a parameter table as text."""
    value, error = row.get("value"), row.get("standard error")
    text = f"{value:.4g}"
    if error is not None and np.isfinite(error) and error > 0.0:
        text = f"{by_error(value, error)} ± {by_error(error, error)}"
    bounds = [f"{end:g}" if end is not None and np.isfinite(end) else "–" for end in (row.get("low"), row.get("high"))]
    determined = {True: "yes", False: "no", None: "–"}[row.get("determined")]
    return str(row["parameter"]), text, str(row.get("unit") or "–"), " to ".join(bounds), determined
