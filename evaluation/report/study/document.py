"""A study as strict JSON."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from evaluation.report.document import plain
from evaluation.study import StudyResults, controller_figures, exploit_figures, forecast_figures, prediction_figures
from evaluation.study.repeats import RESAMPLES, SHARE

SCHEMA = "sysid-evo/study/1"


def study_document(results: StudyResults) -> dict[str, Any]:
    """Return what stands in ``study.json``: settings, points, the figures of all tables, failures, times."""
    document: dict[str, Any] = plain(
        {
            "schema": SCHEMA,
            "title": results.study.title,
            "settings": dict(results.study.settings),
            "group_axes": results.study.group_axes,
            "intervals": {"share": SHARE, "resamples": RESAMPLES, "drawn": ["robots", "seeds of each"]},
            "points": [{**asdict(point), "finished": point.finished} for point in results.points],
            "controllers": [asdict(one) for one in controller_figures(results)],
            "prediction": [
                {**asdict(one), "n": {str(h): n and asdict(n) for h, n in one.n.items()}}
                for one in prediction_figures(results)
            ],
            "exploitability": [asdict(one) for one in exploit_figures(results)],
            "forecasts": [asdict(one) for one in forecast_figures(results)],
            "failures": [asdict(one) for one in results.failures],
            "versions": dict(results.versions),
            "timings": _times(results),
        }
    )
    return document


def _times(results: StudyResults) -> dict[str, dict[str, float]]:
    found: dict[str, dict[str, float]] = {}
    for time in results.times:
        one = found.setdefault(time.kind, {"cells": 0, "seconds": 0.0})
        one["cells"] += 1
        one["seconds"] += time.seconds
    return found
