"""The report: what was found, as tables for a terminal, strict JSON, and a page that opens offline."""

from evaluation.report.elements import Answer
from evaluation.report.report import (
    ReportDocument,
    brief,
    load_report,
    report_schema,
    save_report,
    tables,
    to_html,
    to_json,
    to_markdown,
)
from evaluation.report.sections.advice import advice_lines
from evaluation.report.sections.controllers import drive_command
from evaluation.report.sections.summary import is_empty, verdict
from evaluation.results import ComparisonResults, DataSummary, EpisodeSummary, Failure, ModelSummary

__all__ = [
    "Answer",
    "ComparisonResults",
    "DataSummary",
    "EpisodeSummary",
    "Failure",
    "ModelSummary",
    "ReportDocument",
    "advice_lines",
    "brief",
    "drive_command",
    "load_report",
    "report_schema",
    "save_report",
    "tables",
    "is_empty",
    "to_html",
    "to_json",
    "to_markdown",
    "verdict",
]
