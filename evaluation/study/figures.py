"""Means over robots and seeds with intervals: controllers, models, exploits, forecasts."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import methodcaller
from typing import TypeAlias, TypeVar

import numpy as np

from evaluation.study.results import ControllerRow, ModelRow, PointRow, StudyResults
from evaluation.study.study import CONTROLLER, group_name
from evaluation.transfer.summary import rank_correlation
from sysid_evo.validation.estimates import across

FEWEST = 3
"""Minimum number of robots, or of seeds of a single robot, for an interval."""

Repeats: TypeAlias = Mapping[tuple[str, str], float]
"""A number by robot and seed."""


@dataclass(frozen=True)
class Spread:
    """The mean over ``robots`` of the mean over seeds, and its 95 % interval, None if there is none.

    ``lowest`` and ``highest`` are those of single points, ``points`` is their number.
    """

    mean: float
    low: float | None
    high: float | None
    lowest: float
    highest: float
    robots: int
    points: int

    @classmethod
    def of(cls, repeats: Repeats) -> Spread | None:
        """Return the spread of numbers by robot and seed, None without any; NaN is left out."""
        known = {key: value for key, value in repeats.items() if np.isfinite(value)}
        if not known:
            return None
        values, of_robot = list(known.values()), [robot for robot, _ in known]
        robots, found = len(set(of_robot)), across(values, of_robot)
        enough = (robots if robots > 1 else len(values)) >= FEWEST
        low, high = found.interval if enough else (None, None)
        return cls(found.value, low, high, min(values), max(values), robots, len(values))


def differences(first: Repeats, second: Repeats) -> Repeats:
    """Return the first minus the second for each robot and seed that both have."""
    return {key: first[key] - second[key] for key in first if key in second}


CHOSEN, HINDSIGHT = "chosen by forecast", "best in hindsight"
"""Additional rows: the controller chosen in each point without the robot, and the best one there."""


def interquartile_mean(repeats: Repeats) -> float | None:
    """Return the mean of the middle half of numbers by robot and seed, None for none; its ends count in part."""
    values = np.sort([value for value in repeats.values() if np.isfinite(value)])
    weights = np.diff(np.clip(np.linspace(0.0, 1.0, len(values) + 1), 0.25, 0.75))
    return float(2.0 * weights @ values) if len(values) else None


def probability_of_improvement(first: Repeats, second: Repeats) -> float | None:
    """Return how often a seed of the first is better than one of the second on the same robot; ties count half.

    It is the mean over robots, None without a common one. Source: Agarwal et al., NeurIPS 2021, section 4.3.
    """
    shares = []
    for robot in dict.fromkeys(robot for robot, _ in first):
        ours, theirs = ([v for (name, _), v in of.items() if name == robot] for of in (first, second))
        pairs = [(one > two) + 0.5 * (one == two) for one in ours for two in theirs]
        shares += [np.mean(pairs)] if pairs else []
    return float(np.mean(shares)) if shares else None


@dataclass(frozen=True)
class ControllerFigures:
    """One row: a controller in the points of one ``group``, over robots and seeds.

    ``normalised`` is the achieved share of the best known fitness, ``gap`` claimed minus achieved fitness.
    ``difference`` is the normalised fitness of the reference minus that of this controller, paired by robot and seed.
    ``middle`` is the interquartile mean of the normalised fitness, ``improvement`` the probability that the reference
    is better. They are None if unknown. ``planned`` points could have the controller, in ``failed`` it was not made.
    """

    group: tuple[str, ...]
    controller: str
    kind: str
    normalised: Spread | None
    gap: Spread | None
    difference: Spread | None
    planned: int
    failed: int
    is_reference: bool = False
    middle: float | None = None
    improvement: float | None = None

    def name(self, axes: Sequence[str]) -> str:
        """Return the controller, followed by its group by these axes."""
        group = group_name(axes, self.group)
        return f"{self.controller} ({group})" if group else self.controller


def controller_figures(results: StudyResults) -> tuple[ControllerFigures, ...]:
    """Return a row for each controller of each group, the best on average first in each group."""
    rows = dict(_rows(results))
    reference = _reference(results, list(rows))
    compared = {} if reference is None else _by_point(results, rows[reference], lambda row: row.normalised)
    found = []
    for key, own in rows.items():
        group, name = key
        normalised = _by_point(results, own, lambda row: row.normalised)
        difference = {} if key == reference else differences(compared, normalised)
        failed = sum(bool(row.reason) for row in own)
        if not normalised and not failed:
            continue  # evolved, but not run on the robot yet
        kinds = {row.kind for row in own}
        found.append(
            ControllerFigures(
                group=group,
                controller=name,
                kind=next(iter(kinds)) if len(kinds) == 1 else "",
                normalised=Spread.of(normalised),
                gap=Spread.of(_by_point(results, own, _gap)),
                difference=Spread.of(difference),
                planned=len(own),
                failed=failed,
                is_reference=key == reference,
                middle=interquartile_mean(normalised),
                improvement=None if key == reference else probability_of_improvement(compared, normalised),
            )
        )
    return _in_groups(found, lambda one: -(one.normalised.mean if one.normalised else -1e9))


def _rows(results: StudyResults) -> Iterator[tuple[tuple[tuple[str, ...], str], list[ControllerRow]]]:
    """Yield the rows of each controller of each group, then of those that are chosen in each point."""
    groups: dict[tuple[str, ...], dict[str, list[ControllerRow]]] = {}
    by_point: dict[str, list[ControllerRow]] = {}
    for row in results.controllers:
        point = results.point(row.point)
        name = "one search on the robot" if row.kind == "robot" else row.controller
        groups.setdefault(point.group, {}).setdefault(name, []).append(row)
        by_point.setdefault(row.point, []).append(row)
    for group, controllers in groups.items():
        for name, rows in controllers.items():
            yield (group, name), rows
        own = [by_point[point.name] for point in results.finished if point.group == group and point.name in by_point]
        chosen = [row for rows in own for row in rows if row.chosen]
        if chosen:
            yield (group, CHOSEN), chosen
            yield (group, HINDSIGHT), [best for rows in own if (best := _best(rows)) is not None]


def _best(rows: Sequence[ControllerRow]) -> ControllerRow | None:
    """Return the controller with the highest achieved fitness among those evolved in models."""
    known = [row for row in rows if row.in_models and row.normalised is not None]
    return max(known, key=lambda row: row.normalised or 0.0, default=None)


def _reference(
    results: StudyResults, keys: Sequence[tuple[tuple[str, ...], str]]
) -> tuple[tuple[str, ...], str] | None:
    """Return the row that others are compared with: the one named by the study, else the first polished one."""
    criteria: Mapping[str, str] = results.study.compare_with
    axes = results.study.group_axes
    fitting = [
        (group, name)
        for group, name in keys
        if all(criteria.get(axis, label) == label for axis, label in zip(axes, group, strict=True))
    ]
    kinds = {row.controller: row.kind for row in results.controllers}
    if CONTROLLER in criteria:
        fitting = [(group, name) for group, name in fitting if name == criteria[CONTROLLER]]
        return next(iter(fitting), None)
    polished = [(group, name) for group, name in fitting if kinds.get(name) == "polished"]
    return next(iter(polished or [key for key in fitting if key[1] == CHOSEN]), None)


def _by_point(
    results: StudyResults, rows: Sequence[ControllerRow], figure: Callable[[ControllerRow], float | None]
) -> Repeats:
    known = [(results.point(row.point), value) for row in rows if (value := figure(row)) is not None]
    return {(point.where, point.seed): value for point, value in known}


def _gap(row: ControllerRow) -> float | None:
    """Return claimed minus achieved fitness; a controller evolved on the robot itself has no claim about it."""
    if row.claimed is None or row.achieved is None or not row.in_models:
        return None
    return row.claimed - row.achieved


F = TypeVar("F", ControllerFigures, "PredictionFigures", "ExploitFigures")

HORIZONS = (10, 20, 60)
"""Horizons in steps at which errors are shown."""


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
    """One row: in how many ``assessed`` points a model is ``exploited``, and the share of claims that is kept."""

    group: tuple[str, ...]
    model: str
    exploited: int
    assessed: int
    kept: Spread | None


def prediction_axes(results: StudyResults) -> tuple[str, ...]:
    """Return the axes along which a model's errors differ; the others need no rows of their own."""
    axes = results.study.group_axes
    telling = []
    for place, axis in enumerate(axes):
        seen: dict[tuple[object, ...], set[tuple[object, ...]]] = {}
        for row in results.models:
            point = results.point(row.point)
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
    return _in_groups(found, lambda one: np.inf if (n := one.n[20]) is None else n.mean)


def exploit_figures(results: StudyResults) -> tuple[ExploitFigures, ...]:
    """Return a row for each model of each group in which a controller was evolved in it alone."""
    found = []
    for (group, model), own in _grouped(results, lambda point: point.group).items():
        assessed = [row.exploited for _, row in own if row.exploited is not None]
        if assessed:
            once = {(point.where, point.seed): row for point, row in own}
            kept = _spread(once, lambda row: row.kept)
            found.append(ExploitFigures(group, model, sum(assessed), len(assessed), kept))
    return _in_groups(found, lambda one: one.exploited / one.assessed)


def _in_groups(found: Sequence[F], figure: Callable[[F], float]) -> tuple[F, ...]:
    """Return rows in the order of their groups, in each by a figure, the lowest first."""
    order = list(dict.fromkeys(one.group for one in found))
    return tuple(sorted(found, key=lambda one: (order.index(one.group), figure(one))))


def _grouped(
    results: StudyResults, group: Callable[[PointRow], tuple[str, ...]]
) -> dict[tuple[tuple[str, ...], str], list[tuple[PointRow, ModelRow]]]:
    found: dict[tuple[tuple[str, ...], str], list[tuple[PointRow, ModelRow]]] = {}
    for row in results.models:
        point = results.point(row.point)
        found.setdefault((group(point), row.model), []).append((point, row))
    return found


def _spread(rows: Mapping[tuple[str, str], ModelRow], figure: Callable[[ModelRow], float | None]) -> Spread | None:
    values = {key: figure(row) for key, row in rows.items()}
    return Spread.of({key: value for key, value in values.items() if value is not None})


FIGURES: Mapping[str, Callable[[ControllerRow], float | None]] = {
    "forecast": lambda row: row.forecast,
    "claim": lambda row: row.claimed,
    "prediction error": lambda row: None if row.error is None else -row.error,
}
"""Figures by which a controller could be chosen without the robot; more is better."""
FITNESS = ("forecast", "claim")
"""Those that are a fitness, so that they have an error."""


@dataclass(frozen=True)
class ForecastFigures:
    """One row: ranking and choice by one ``figure`` within the points of one group, over robots and seeds.

    ``correlation`` is Spearman's with achieved fitness. ``loss`` is the share of the best known fitness by which the
    chosen controller is below the best, ``rmse`` the error of a fitness, over all ``controllers``. ``inside`` is the
    share of 90 % intervals that contain the achieved fitness, for forecasts alone.
    """

    group: tuple[str, ...]
    figure: str
    correlation: Spread | None
    loss: Spread | None
    rmse: float | None
    inside: Spread | None
    controllers: int


def forecast_figures(results: StudyResults) -> tuple[ForecastFigures, ...]:
    """Return a row for each figure of each group, over its finished points."""
    by_point: dict[str, list[ControllerRow]] = {}
    for row in results.controllers:
        if row.in_models and row.achieved is not None and row.forecast is not None:
            by_point.setdefault(row.point, []).append(row)
    groups: dict[tuple[str, ...], list[tuple[PointRow, list[ControllerRow]]]] = {}
    for point in results.finished:
        if point.name in by_point:
            groups.setdefault(point.group, []).append((point, by_point[point.name]))
    return tuple(_figures(group, name, own) for group, own in groups.items() for name in FIGURES)


def _figures(
    group: tuple[str, ...], name: str, points: Sequence[tuple[PointRow, list[ControllerRow]]]
) -> ForecastFigures:
    figure = FIGURES[name]
    correlations: dict[tuple[str, str], float] = {}
    losses: dict[tuple[str, str], float] = {}
    inside: dict[tuple[str, str], float] = {}
    misses: list[float] = []
    for point, rows in points:
        key = (point.where, point.seed)
        known = [(value, row) for row in rows if (value := figure(row)) is not None]
        pairs = [(value, row.achieved) for value, row in known if row.achieved is not None]
        correlation = rank_correlation(pairs)
        if correlation is not None:
            correlations[key] = correlation
        reached = [(value, row.normalised) for value, row in known if row.normalised is not None]
        if reached:
            losses[key] = max(fitness for _, fitness in reached) - max(reached, key=lambda pair: pair[0])[1]
        held = [row.within_forecast for _, row in known if row.within_forecast is not None]
        if held:
            inside[key] = float(np.mean(held))
        misses += [value - achieved for value, achieved in pairs]
    return ForecastFigures(
        group=group,
        figure=name,
        correlation=Spread.of(correlations),
        loss=Spread.of(losses),
        rmse=float(np.sqrt(np.mean(np.square(misses)))) if misses and name in FITNESS else None,
        inside=Spread.of(inside) if name == "forecast" else None,
        controllers=sum(len(rows) for _, rows in points),
    )
