"""The tables of a report."""

from evaluation.report.tables.background import (
    advice_sheet,
    channel_list,
    episode_sheet,
    failure_sheet,
    key_sheet,
    model_sheet,
)
from evaluation.report.tables.behaviour import behaviour_sheet, manner_sheet
from evaluation.report.tables.controllers import (
    controller_sheet,
    exploitability_sheet,
    finalist_sheet,
    measure_sheet,
    probe_sheet,
    transfer_sheet,
)
from evaluation.report.tables.errors import (
    difference_sheet,
    episode_error_sheet,
    fit_sheet,
    region_sheet,
    residual_sheet,
)
from evaluation.report.tables.paper import paper_sheet
from evaluation.report.tables.prediction import channel_sheet, condition_sheet, coverage_sheet, prediction_sheet
from evaluation.report.tables.standings import standing_sheet

__all__ = [
    "advice_sheet",
    "behaviour_sheet",
    "channel_list",
    "channel_sheet",
    "condition_sheet",
    "controller_sheet",
    "coverage_sheet",
    "difference_sheet",
    "episode_error_sheet",
    "episode_sheet",
    "exploitability_sheet",
    "finalist_sheet",
    "failure_sheet",
    "fit_sheet",
    "key_sheet",
    "manner_sheet",
    "measure_sheet",
    "model_sheet",
    "paper_sheet",
    "prediction_sheet",
    "probe_sheet",
    "region_sheet",
    "residual_sheet",
    "standing_sheet",
    "transfer_sheet",
]
