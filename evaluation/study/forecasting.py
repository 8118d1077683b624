"""How well forecasts tell what controllers achieve, beside what else could be chosen by."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from evaluation.study.repeats import Repeats, Spread
from evaluation.study.results import ControllerRow, PointRow, StudyResults
from evaluation.transfer.ranks import rank_correlation

FIGURES: Mapping[str, Callable[[ControllerRow], float | None]] = {
    "forecast": lambda row: row.forecast,
    "claim": lambda row: row.claimed,
    "prediction error": lambda row: None if row.error is None else -row.error,
}
"""By what a controller could be chosen without the robot; more is better."""
FITNESS = ("forecast", "claim")
"""Those that are a fitness, so that one can say by how much they miss."""


@dataclass(frozen=True)
class ForecastFigures:
    """One row: ranking and choosing by one ``figure`` within the points of one group, over robots and seeds.

    ``correlation`` is Spearman's with what is achieved, ``loss`` the share of the yardstick by which the controller
    that is chosen falls short of the best, ``rmse`` by how much a fitness misses, over all ``controllers``;
    ``inside`` the share of 90 % intervals that hold what is achieved, of forecasts alone.
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
        shares = [(value, row.share) for value, row in known if row.share is not None]
        if shares:
            losses[key] = max(share for _, share in shares) - max(shares, key=lambda pair: pair[0])[1]
        held = [row.expected for _, row in known if row.expected is not None]
        if held:
            inside[key] = float(np.mean(held))
        misses += [value - achieved for value, achieved in pairs]
    return ForecastFigures(
        group=group,
        figure=name,
        correlation=Spread.of(correlations),
        loss=Spread.of(losses),
        rmse=float(np.sqrt(np.mean(np.square(misses)))) if misses and name in FITNESS else None,
        inside=_if(name == "forecast", inside),
        controllers=sum(len(rows) for _, rows in points),
    )


def _if(wanted: bool, repeats: Repeats) -> Spread | None:
    return Spread.of(repeats) if wanted else None
