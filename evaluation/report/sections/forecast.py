"""What is expected on the robot, beside what was achieved there."""

from __future__ import annotations

from evaluation.report.contents import Report
from evaluation.report.forecasting import forecast_sheet, model_forecast_sheet
from evaluation.report.sections.section import Section, present


def section(report: Report) -> Section | None:
    """Return the forecasts of controllers and models; None where no controller has one."""
    items = present(forecast_sheet(report), model_forecast_sheet(report))
    return Section("Forecast", items) if items else None
