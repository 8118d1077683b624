"""The report: what was found, as tables for a terminal, strict JSON, and a page that opens offline."""

from evaluation.report.report import load_report, report_schema

__all__ = ["load_report", "report_schema"]
