"""A study as a story, of which pages and Markdown are made."""

from __future__ import annotations

from evaluation.report.sections import Section
from evaluation.report.sections.section import present
from evaluation.report.sheets import Sheet
from evaluation.report.story import Story
from evaluation.report.study.headlines import findings, headlines
from evaluation.report.study.pictures import error_picture, gap_picture, share_picture
from evaluation.report.study.tables import (
    controller_sheet,
    exploit_sheet,
    failure_sheet,
    forecast_sheet,
    point_sheet,
    prediction_sheet,
    short_sheet,
    time_sheet,
)
from evaluation.study import StudyResults
from evaluation.study.axes import label_of


def study_story(results: StudyResults) -> Story:
    """Tell what a study found."""
    controllers = present(share_picture(results), controller_sheet(results), gap_picture(results))
    models = present(error_picture(results), prediction_sheet(results), exploit_sheet(results))
    forecasts = present(forecast_sheet(results))
    failed = present(failure_sheet(results))
    sections = [
        Section("Controllers", controllers, absent=[] if controllers else ["No controller was run on a robot."]),
        Section("Models", models, absent=[] if models else ["No model is fitted yet."]),
        Section(
            "Forecasts", forecasts, absent=[] if forecasts else ["No finished point has controllers with forecasts."]
        ),
        Section("Time", [time_sheet(results)]),
        Section("Points", [point_sheet(results)]),
        *([Section("Failures", failed)] if failed else []),
        Section("Settings", [settings_sheet(results)], background=True),
    ]
    return Story(results.study.title, headlines(results), findings(results), short_sheet(results), sections)


def settings_sheet(results: StudyResults) -> Sheet:
    """What all points share, the axes, and the versions of what computed them."""
    study = results.study
    rows = [(name, label_of(value)) for name, value in study.experiment.items()]
    for grid in study.grids:
        rows += [(f"{axis} (axis)", "; ".join(values.values)) for axis, values in grid.items()]
    rows += [(f"version of {name}", version) for name, version in results.versions.items()]
    return Sheet("Settings", ("name", "value"), tuple(rows), prose=True, details=True)
