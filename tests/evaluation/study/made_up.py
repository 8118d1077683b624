"""A study that was never computed, with rows whose truth is known."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from evaluation.study import ControllerRow, ModelRow, PointRow, Study, StudyResults
from evaluation.study.results import CellTime, Error, with_yardsticks

CARS = ("emulated_car", "emulated_car(seed=1)", "emulated_car(seed=2)")


def made_up(cars: int = 3, seeds: int = 3, *, missing: str = "", **settings: Any) -> StudyResults:
    """Return results of ``best`` (10 on every car), ``worse`` (8) and ``both`` (9 and chosen).

    ``worse`` claims 12, the others what they achieve. Cars differ by their number; the point ``missing`` is unfinished.
    """
    grid: Mapping[str, Any] = {"robot": list(CARS[:cars]), "seed": list(range(seeds)), **settings}
    study = Study.of({"title": "Made up", "grid": grid})
    points, rows, models = [], [], []
    for point in study.points:
        car = float(CARS.index(point.labels["robot"]))
        lacks = 5 if point.name == missing else 0
        seed = point.labels["seed"]
        points.append(
            PointRow(point.name, point.labels, point.where, seed, point.group, 10, 10 - lacks, 0, lacks, unit="points")
        )
        for name, value, claim, kind in (
            ("best", 10, 10, "single"),
            ("worse", 8, 12, "single"),
            ("both", 9, 9, "polished"),
        ):
            rows.append(
                ControllerRow(
                    point=point.name,
                    controller=name,
                    kind=kind,  # type: ignore[arg-type]  # one of three
                    members=("best", "worse"),
                    claimed=claim + car,
                    achieved=value + car,
                    forecast=value + car + (1.5 if name == "both" else 0.0),
                    forecast_low=value + car - 1.0,
                    forecast_high=value + car + 1.0,
                    expected=name != "both",
                    error=0.1 if name == "best" else 0.2,
                    chosen=name == "both" and not lacks,
                )
            )
        for name, error in (("best", 0.1), ("worse", 0.2)):
            errors = tuple(Error(h, error * h, 0.0, 1.0) for h in (10, 20, 60))
            models.append(ModelRow(point.name, name, name, errors, exploited=name == "worse", kept=0.9, seconds=2.0))
    times = (CellTime("fit", 2.0), CellTime("fit", 4.0), CellTime("run", 60.0, failed=True))
    return StudyResults(study, tuple(points), tuple(models), with_yardsticks(points, rows), (), times)
