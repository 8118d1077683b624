"""The report: what was found, as tables for a terminal, strict JSON, and a page that opens offline."""

from evaluation.report.elements import Finding
from evaluation.report.report import brief, report_schema, save_report, tables, to_html, to_json, to_markdown
from evaluation.report.sections.advice import advice_lines
from evaluation.report.sections.controllers import drive_command
from evaluation.report.sections.summary import is_empty, verdict
from evaluation.results import ComparisonResults, DataSummary, EpisodeSummary, Failure, ModelSummary

__all__ = [
    "ComparisonResults",
    "DataSummary",
    "EpisodeSummary",
    "Failure",
    "Finding",
    "ModelSummary",
    "advice_lines",
    "brief",
    "drive_command",
    "report_schema",
    "save_report",
    "tables",
    "is_empty",
    "to_html",
    "to_json",
    "to_markdown",
    "verdict",
]
