"""The rows of a study as Parquet: points, models, controllers and cells, each column with its meaning and unit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from evaluation.study.results import ModelRow, StudyResults
from sysid_evo.files import write_atomically

POINT_COLUMNS = {
    "point": "name of the point",
    "where": "robot, or recordings",
    "cells": "cells of the point, shared ones included",
    "done": "cells that are done",
    "failed": "cells that failed, or could not be computed because one they need failed",
    "missing": "cells that are not computed yet",
    "task": "task",
    "unit": "unit of fitness",
    "chosen": "controller that the program picks by its forecast; empty for none",
}
MODEL_COLUMNS = {
    "point": "name of the point",
    "model": "label of the model",
    "family": "registered name of its family",
    "exploited": "whether the claims made in it exceed what is achieved by a tenth and two standard errors",
    "claimed": "mean claim of the controllers evolved in it, unit of fitness",
    "achieved": "mean of what these achieve on the robot, unit of fitness",
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
    "kind": "single, ensemble, recommended, robot (evolved on it) or by hand",
    "members": "models that it was planned to be evolved against, joined by +",
    "aggregate": "rule by which several models become one fitness",
    "claimed": "fitness where it was evolved, unit of fitness",
    "achieved": "fitness on the robot, unit of fitness",
    "achieved_error": "standard error of that over trials, unit of fitness",
    "forecast": "what was expected of it on the robot, unit of fitness",
    "forecast_low": "lower end of the 90 % interval of the forecast, unit of fitness",
    "forecast_high": "upper end of the 90 % interval of the forecast, unit of fitness",
    "expected": "whether what is achieved lies in that interval",
    "worst": "lowest fitness on a system that it was not evolved against, unit of fitness",
    "worst_on": "that system",
    "error": "mean N after 20 steps of its members",
    "exploited": "whether its claim exceeds what is achieved by a tenth and two standard errors",
    "floor": "what controls at rest achieve, unit of fitness; missing where fitness begins at 0",
    "yardstick": "best achieved on this robot in the study, unit of fitness",
    "share": "(achieved - floor) / (yardstick - floor)",
    "chosen": "whether the program picks it by its forecast",
    "file": "its file in the folder of the study",
    "reason": "why there is none; empty for none",
}
CELL_COLUMNS = {
    "kind": "kind of work",
    "seconds": "how long it took, s",
    "failed": "whether it failed",
}


AXIS = "axis_{}"
"""The column of an axis, so that it never has the name of another."""


def save_parquet(results: StudyResults, folder: Path) -> tuple[Path, ...]:
    """Write ``points``, ``models``, ``controllers`` and ``cells.parquet`` into ``folder``; return the files."""
    axes = {AXIS.format(axis): f"label of the value of {axis}" for axis in results.study.axes}
    horizons = sorted({error.horizon for row in results.models for error in row.errors})
    errors = {name.format(h): text.format(h) for h in horizons for name, text in N_COLUMNS.items()}
    labels = {point.name: {AXIS.format(a): text for a, text in point.labels.items()} for point in results.points}
    points = [{**asdict(point), **labels[point.name], "point": point.name} for point in results.points]
    models = [{**asdict(row), **labels[row.point], **_n(row)} for row in results.models]
    controllers = [
        {**asdict(row), **labels[row.point], "members": "+".join(row.members)} for row in results.controllers
    ]
    return (
        _write(folder / "points.parquet", points, {**POINT_COLUMNS, **axes}),
        _write(folder / "models.parquet", models, {**MODEL_COLUMNS, **axes, **errors}),
        _write(folder / "controllers.parquet", controllers, {**CONTROLLER_COLUMNS, **axes}),
        _write(folder / "cells.parquet", [asdict(time) for time in results.times], CELL_COLUMNS),
    )


def _n(row: ModelRow) -> dict[str, float]:
    found = {}
    for error in row.errors:
        for name, value in zip(N_COLUMNS, (error.n, error.low, error.high), strict=True):
            found[name.format(error.horizon)] = value
    return found


def _write(path: Path, rows: Sequence[Mapping[str, Any]], columns: Mapping[str, str]) -> Path:
    """Write the ``columns`` of ``rows``; what each means stands in the description of its field."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pa.table({name: pa.array([row.get(name) for row in rows]) for name in columns})
    fields = [table.schema.field(name).with_metadata({"description": text}) for name, text in columns.items()]
    table = table.cast(pa.schema(fields))
    return write_atomically(path, lambda file: pq.write_table(table, file))
