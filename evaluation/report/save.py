"""Writes a report into a folder."""

from __future__ import annotations

import json
from pathlib import Path

from evaluation.report.contents import Report
from evaluation.report.document import to_json
from sysid_evo.files import write_atomically

DOCUMENT, PAGE = "report.json", "report.html"


def save_report(report: Report, folder: str | Path) -> tuple[Path, Path]:
    """Write ``report.json`` and ``report.html`` into ``folder`` and return their paths."""
    from evaluation.report.page import to_html  # brings matplotlib, for which no mistake should wait

    folder = Path(folder)
    text = json.dumps(to_json(report), indent=1, allow_nan=False, ensure_ascii=False) + "\n"
    page = to_html(report)
    return (
        write_atomically(folder / DOCUMENT, lambda file: file.write_text(text, encoding="utf-8")),
        write_atomically(folder / PAGE, lambda file: file.write_text(page, encoding="utf-8")),
    )
