"""How well families predict over robots and seeds, and how often the controllers evolved in them exploit them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from operator import methodcaller

from evaluation.study.repeats import Spread
from evaluation.study.results import ModelRow, PointRow, StudyResults

HORIZONS = (10, 20, 60)
"""Steps ahead at which errors are shown."""


@dataclass(frozen=True)
class PredictionFigures:
    """One row: N of a model at each of ``HORIZONS`` and the seconds of a fit, over robots and seeds."""

    group: tuple[str, ...]
    model: str
    n: Mapping[int, Spread | None]
    seconds: Spread | None
    fits: int
    failed: int


@dataclass(frozen=True)
class ExploitFigures:
    """One row: in how many of the ``judged`` points a model is ``exploited``, and the share of claims that is kept."""

    group: tuple[str, ...]
    model: str
    exploited: int
    judged: int
    kept: Spread | None


def prediction_axes(results: StudyResults) -> tuple[str, ...]:
    """Return the axes along which a model's errors differ; the others need no rows of their own."""
    axes = results.study.group_axes
    telling = []
    for place, axis in enumerate(axes):
        seen: dict[tuple[object, ...], set[tuple[object, ...]]] = {}
        for point, row in _placed(results):
            rest = (point.where, point.seed, row.model, *point.group[:place], *point.group[place + 1 :])
            seen.setdefault(rest, set()).add(tuple(error.n for error in row.errors))
        if any(len(values) > 1 for values in seen.values()):
            telling.append(axis)
    return tuple(telling)


def prediction_figures(results: StudyResults) -> tuple[PredictionFigures, ...]:
    """Return a row for each model, in groups of the axes of `prediction_axes`; the lowest error at 20 steps first."""
    axes = prediction_axes(results)
    places = [results.study.group_axes.index(axis) for axis in axes]
    rows = _grouped(results, lambda point: tuple(point.group[place] for place in places))
    found = []
    for (group, model), own in rows.items():
        once = {(point.where, point.seed): row for point, row in own}
        found.append(
            PredictionFigures(
                group=group,
                model=model,
                n={h: _spread(once, methodcaller("n", h)) for h in HORIZONS},
                seconds=_spread(once, lambda row: row.seconds),
                fits=len(once),
                failed=sum(bool(row.reason) for row in once.values()),
            )
        )
    order = list(dict.fromkeys(one.group for one in found))
    return tuple(sorted(found, key=lambda one: (order.index(one.group), _mean(one.n[20]))))


def exploit_figures(results: StudyResults) -> tuple[ExploitFigures, ...]:
    """Return a row for each model of each group in which some controller was evolved alone."""
    found = []
    for (group, model), own in _grouped(results, lambda point: point.group).items():
        judged = [row.exploited for _, row in own if row.exploited is not None]
        if judged:
            once = {(point.where, point.seed): row for point, row in own}
            kept = _spread(once, lambda row: row.kept)
            found.append(ExploitFigures(group, model, sum(judged), len(judged), kept))
    order = list(dict.fromkeys(one.group for one in found))
    return tuple(sorted(found, key=lambda one: (order.index(one.group), one.exploited / one.judged)))


def _placed(results: StudyResults) -> list[tuple[PointRow, ModelRow]]:
    places = {point.name: point for point in results.points}
    return [(places[row.point], row) for row in results.models]


def _grouped(
    results: StudyResults, group: Callable[[PointRow], tuple[str, ...]]
) -> dict[tuple[tuple[str, ...], str], list[tuple[PointRow, ModelRow]]]:
    found: dict[tuple[tuple[str, ...], str], list[tuple[PointRow, ModelRow]]] = {}
    for point, row in _placed(results):
        found.setdefault((group(point), row.model), []).append((point, row))
    return found


def _spread(rows: Mapping[tuple[str, str], ModelRow], figure: Callable[[ModelRow], float | None]) -> Spread | None:
    values = {key: figure(row) for key, row in rows.items()}
    return Spread.of({key: value for key, value in values.items() if value is not None})


def _mean(spread: Spread | None) -> float:
    return float("inf") if spread is None else spread.mean
