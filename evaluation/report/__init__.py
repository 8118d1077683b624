"""The report: what was found, as tables for a terminal, strict JSON, and a page that opens offline."""

from evaluation.report.contents import DataSummary, EpisodeSummary, Failure, ModelSummary, Report
from evaluation.report.document import report_schema, to_json
from evaluation.report.overview import drive_command
from evaluation.report.save import save_report
from evaluation.report.terminal import advice_lines, brief, tables
from evaluation.report.verdict import Finding, tells_nothing, verdict

__all__ = [
    "DataSummary",
    "EpisodeSummary",
    "Failure",
    "Finding",
    "ModelSummary",
    "Report",
    "advice_lines",
    "brief",
    "drive_command",
    "report_schema",
    "save_report",
    "tables",
    "tells_nothing",
    "to_json",
    "verdict",
]
