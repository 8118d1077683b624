"""What each kind of controller is worth over robots and seeds, and how it compares with the reference."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from evaluation.study.repeats import Repeats, Spread, paired
from evaluation.study.results import ControllerRow, PointRow, StudyResults
from evaluation.study.study import CONTROLLER, group_name

CHOSEN, HINDSIGHT = "chosen by forecast", "best in hindsight"
"""Rows of their own: what the program picks in each point without the robot, and what would have been best."""


@dataclass(frozen=True)
class ControllerFigures:
    """One row: a controller in the points of one ``group``, over robots and seeds.

    ``share`` of the yardstick that is achieved, ``gap`` claimed minus achieved in the unit of fitness, ``difference``
    the share of the reference minus that of this one, paired by robot and seed; None where there is nothing to tell.
    ``planned`` is the number of points that could have it, ``failed`` that of those in which it could not be made.
    """

    group: tuple[str, ...]
    controller: str
    kind: str
    share: Spread | None
    gap: Spread | None
    difference: Spread | None
    planned: int
    failed: int
    is_reference: bool = False

    def name(self, axes: Sequence[str]) -> str:
        """Return the controller, and behind it its group by these axes."""
        group = group_name(axes, self.group)
        return f"{self.controller} ({group})" if group else self.controller


def controller_figures(results: StudyResults) -> tuple[ControllerFigures, ...]:
    """Return a row for each controller of each group; of each group the best on average first."""
    rows = dict(_rows(results))
    reference = _reference(results, list(rows))
    compared = {} if reference is None else _by_point(results, rows[reference], lambda row: row.share)
    found = []
    for key, own in rows.items():
        group, name = key
        share = _by_point(results, own, lambda row: row.share)
        difference = {} if key == reference else paired(compared, share)
        failed = sum(bool(row.reason) for row in own)
        if not share and not failed:
            continue  # evolved, but not run on the robot yet
        kinds = {row.kind for row in own}
        found.append(
            ControllerFigures(
                group=group,
                controller=name,
                kind=next(iter(kinds)) if len(kinds) == 1 else "",
                share=Spread.of(share),
                gap=Spread.of(_by_point(results, own, _gap)),
                difference=Spread.of(difference),
                planned=len(own),
                failed=failed,
                is_reference=key == reference,
            )
        )
    order = list(dict.fromkeys(figures.group for figures in found))
    return tuple(sorted(found, key=lambda one: (order.index(one.group), -(one.share.mean if one.share else -1e9))))


def _rows(results: StudyResults) -> Iterator[tuple[tuple[tuple[str, ...], str], list[ControllerRow]]]:
    """Yield the rows of each controller of each group, then of those that are picked in each point."""
    groups: dict[tuple[str, ...], dict[str, list[ControllerRow]]] = {}
    places = {point.name: point for point in results.points}
    by_point: dict[str, list[ControllerRow]] = {}
    for row in results.controllers:
        point = places[row.point]
        name = "the robot itself" if row.kind == "robot" else row.controller
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
    """Return the controller that achieves most of those that were evolved in models."""
    known = [row for row in rows if row.in_models and row.share is not None]
    return max(known, key=lambda row: row.share or 0.0, default=None)


def _reference(
    results: StudyResults, keys: Sequence[tuple[tuple[str, ...], str]]
) -> tuple[tuple[str, ...], str] | None:
    """Return which row others are compared with: the one that the study names, else the first recommended one."""
    asked: Mapping[str, str] = results.study.reference
    axes = results.study.group_axes
    fitting = [
        (group, name)
        for group, name in keys
        if all(asked.get(axis, label) == label for axis, label in zip(axes, group, strict=True))
    ]
    kinds = {row.controller: row.kind for row in results.controllers}
    wanted: Callable[[str], bool] = lambda name: kinds.get(name) == "recommended"  # noqa: E731
    if CONTROLLER in asked:
        fitting = [(group, name) for group, name in fitting if name == asked[CONTROLLER]]
        return next(iter(fitting), None)
    recommended = [(group, name) for group, name in fitting if wanted(name)]
    return next(iter(recommended or [key for key in fitting if key[1] == CHOSEN]), None)


def _by_point(
    results: StudyResults, rows: Sequence[ControllerRow], figure: Callable[[ControllerRow], float | None]
) -> Repeats:
    places: dict[str, PointRow] = {point.name: point for point in results.points}
    found = {}
    for row in rows:
        value = figure(row)
        if value is not None:
            point = places[row.point]
            found[point.where, point.seed] = value
    return found


def _gap(row: ControllerRow) -> float | None:
    """Return what is claimed too much; what was evolved on the robot itself claims nothing about it."""
    if row.claimed is None or row.achieved is None or not row.in_models:
        return None
    return row.claimed - row.achieved
