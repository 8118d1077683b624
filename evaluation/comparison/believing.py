"""Which models are believed about a controller: those that predict held-out data about as well as the best."""

from __future__ import annotations

from collections.abc import Sequence

from evaluation.comparison.columns import Column
from evaluation.forecast import error_of
from sysid_evo.plan import Work

BELIEVED = 1.5
"""How many times the error of the best model a model may have to be believed."""
FAMILIES = 2
"""The best of this many families are always believed, so that there is one to judge what comes from the other."""


def believed(columns: Sequence[Column], work: Work) -> tuple[Column, ...]:
    """Return those of ``columns`` that predict well: N at most `BELIEVED` times that of the best.

    A model that misses a lag or a force of the robot tells nothing about fast controllers, and several such models
    agree on it: their median would overrate what exploits it. Robots, and models whose error is not known, are
    believed. So are the best models of two families in any case.
    """
    errors = {column.label: error for column in columns if (error := prediction_error(column, work)) is not None}
    if not errors:
        return tuple(columns)
    families: dict[str, float] = {}
    for column in columns:
        if column.label in errors:
            families[column.registered] = min(families.get(column.registered, float("inf")), errors[column.label])
    enough = sorted(families.values())[:FAMILIES][-1]
    limit = max(enough, BELIEVED * min(errors.values()))
    return tuple(column for column in columns if errors.get(column.label, 0.0) <= limit)


def prediction_error(column: Column, work: Work) -> float | None:
    """Return N of a model on held-out data, None where it is not known."""
    return None if column.prediction is None else error_of(work.result(column.prediction))
