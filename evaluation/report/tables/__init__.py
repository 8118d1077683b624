"""The tables of a report."""

from evaluation.report.tables.background import channel_list, episode_sheet, failure_sheet, key_sheet, model_sheet
from evaluation.report.tables.controllers import (
    controller_sheet,
    exploitability_sheet,
    finalist_sheet,
    measure_sheet,
    probe_sheet,
    transfer_sheet,
)
from evaluation.report.tables.prediction import channel_sheet, coverage_sheet, prediction_sheet

__all__ = [
    "channel_list",
    "channel_sheet",
    "controller_sheet",
    "coverage_sheet",
    "episode_sheet",
    "exploitability_sheet",
    "finalist_sheet",
    "failure_sheet",
    "key_sheet",
    "measure_sheet",
    "model_sheet",
    "prediction_sheet",
    "probe_sheet",
    "transfer_sheet",
]
